"""One process with many branches: FAME beside rust_bpmn_analyzer, which explores all states of processes like these.

    pip install rust_bpmn_analyzer-bindings
    python benchmarks/bpmn_analyzer.py [--seconds S]

The models are of the kind on which that tool was measured: blocks of parallel branches, one after the other, with one
task in each branch. Both say whether a run deadlocks, enters every task and ends once; rust_bpmn_analyzer in four
questions, FAME in one exploration. Each case is a process of its own; its seconds (CPU) include reading the model, and
not the start of Python. A case that does not end within S seconds (default 60) says so. It refuses call activities, so
FAME's missions cannot be compared.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

CASES = {
    **{f"1 block of {branches}": (1, branches) for branches in (5, 10, 15, 18, 20)},
    **{f"{blocks} blocks of 3": (blocks, 3) for blocks in (10, 50, 200)},
}
QUESTIONS = ("safeness", "option_to_complete", "dead_activities", "proper_completion")


def model(blocks: int, branches: int) -> str:
    """The text of a process. Elements have end tags: rust_bpmn_analyzer does not see them otherwise."""
    ids, nodes, last = list[tuple[str, str]](), [("startEvent", "s")], "s"
    for block in range(blocks):
        split, join = f"p{block}", f"j{block}"
        nodes += [("parallelGateway", split), ("parallelGateway", join)]
        ids.append((last, split))
        for branch in range(branches):
            task = f"t{block}_{branch}"
            nodes.append(("userTask", task))
            ids += [(split, task), (task, join)]
        last = join
    nodes.append(("endEvent", "e"))
    ids.append((last, "e"))
    made = "".join(f'<bpmn:{tag} id="{id}"></bpmn:{tag}>' for tag, id in nodes)
    made += "".join(
        f'<bpmn:sequenceFlow id="f{number}" sourceRef="{source}" targetRef="{target}"/>'
        for number, (source, target) in enumerate(ids)
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?><bpmn:definitions targetNamespace="blocks"'
        ' xmlns:bpmn="http://www.omg.org/spec/BPMN/20100524/MODEL">'
        f'<bpmn:process id="P" isExecutable="true">{made}</bpmn:process></bpmn:definitions>'
    )


def fame(text: str) -> tuple[float, bool]:
    """Seconds of an exploration with delivery ``run``, and whether nothing was found."""
    from fame.bpmn.reader import read_text
    from fame.scenario.explore.exploration import explore

    begun = time.process_time()
    result = explore(read_text(text, file="blocks.bpmn"), delivery="run")
    return time.process_time() - begun, result.exhaustive and not result.findings


def analyzer(text: str) -> tuple[float, bool]:
    """Seconds of its four questions, and whether each is answered by yes."""
    import rust_bpmn_analyzer_bindings as bindings

    begun = time.process_time()
    found = [getattr(bindings, f"analyze_{question}")(text).fulfilled for question in QUESTIONS]
    return time.process_time() - begun, all(found)


TOOLS = {"FAME": fame, "rust_bpmn_analyzer": analyzer}


def measured(tool: str, case: str, seconds: int) -> str:
    """The seconds of a case in a process of its own."""
    command = [sys.executable, __file__, "--case", json.dumps([tool, case])]
    bound = (seconds + 5, seconds + 5)
    done = subprocess.run(command, check=False, capture_output=True, text=True,
                          preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, bound))  # fmt: skip
    if done.returncode:
        return "not installed" if "No module named" in done.stderr else f"not within {seconds}"
    spent, fine = json.loads(done.stdout)
    return f"{spent:.4f}" + ("" if fine else ", finds something")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=int, default=60, metavar="S", help="CPU time of each case (default: 60)")
    parser.add_argument("--case", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.case:
        tool, case = arguments.case
        print(json.dumps(TOOLS[tool](model(*CASES[case]))))
        return
    print(f"{'s (CPU)':16}" + "".join(f"{tool:>22}" for tool in TOOLS))
    for case in CASES:
        print(f"{case:16}" + "".join(f"{measured(tool, case, arguments.seconds):>22}" for tool in TOOLS), flush=True)


if __name__ == "__main__":
    main()
