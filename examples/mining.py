"""Compare what robots did with what was drawn, and with what process mining finds by itself. Needs pm4py.

    fame campaign examples/warehouse.yaml --runs 200 --record -o out/warehouse
    python examples/mining.py models/warehouse.bpmn out/warehouse

For each process and sub-process whose executions the recordings have: how much of the log the diagram explains
(fitness), how much the diagram allows that never happened (precision, by replaying tokens), the same for the model that
the inductive miner discovers, and the activities that took longest. An execution of a process or sub-process is a case.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pm4py
from pm4py.objects.petri_net.obj import Marking, PetriNet
from pm4py.objects.petri_net.utils.petri_utils import add_arc_from_to
from pm4py.util import constants

import fame
from fame.mining.conversion import convert

constants.SHOW_PROGRESS_BAR = False
CASE, TIME = ["run", "robot", "instance", "scope"], "time:timestamp"
CHOICES = ("exclusiveGateway", "eventBasedGateway")
UNSUPPORTED = ("inclusiveGateway", "complexGateway")


class Net:
    """The Petri net of one diagram: a place before each node, one for each flow into a parallel gateway.

    Gateways are silent, as are sub-processes whose repetitions the log has as executions of their own. A boundary event
    takes the token from its activity.
    """

    def __init__(self, body: Any, logged: frozenset[str]) -> None:
        self.net = PetriNet()
        self.start, self.end = self._place("start"), self._place("end")
        self._body, self._logged = body, logged
        joins = {node.id for node in body.nodes if node.tag == "parallelGateway"}
        self._before = {node.id: self._place(node.id) for node in body.nodes if node.id not in joins}
        self._after = {
            flow.id: self._place(flow.id) if flow.target in joins else self._before[flow.target] for flow in body.flows
        }
        for node in body.nodes:
            if node.body is None or node.kind != "event":
                self._add(node)
        self.markings = Marking({self.start: 1}), Marking({self.end: 1})

    def _add(self, node: Any) -> None:
        out = [self._after[flow] for flow in node.outgoing] or [self.end]
        attached = getattr(node, "attached_to", "")
        if node.tag in UNSUPPORTED or (attached and not node.interrupting):
            sys.exit(f"{node.id}: a net of this {node.tag} is not made here")
        before = [self._before[attached or node.id]] if attached or node.id in self._before else []
        if node.tag == "startEvent":
            self._move(node, [self.start], out)
        elif node.tag in CHOICES:
            for target in out:
                self._move(node, before, [target])
        else:
            self._move(node, before or [self._after[flow] for flow in node.incoming], out)

    def _move(self, node: Any, taken: Iterable[PetriNet.Place], given: Iterable[PetriNet.Place]) -> None:
        label = " ".join(node.name.split()) or node.id
        move = PetriNet.Transition(f"{node.id} {len(self.net.transitions)}", label if node.id in self._logged else None)
        self.net.transitions.add(move)
        for place in taken:
            add_arc_from_to(place, move, self.net)
        for place in given:
            add_arc_from_to(move, place, self.net)

    def _place(self, name: str) -> PetriNet.Place:
        place = PetriNet.Place(name)
        self.net.places.add(place)
        return place


def events_of(recordings: Iterable[Path]) -> pd.DataFrame:
    """All events of recordings, a row each."""
    frames = []
    with tempfile.TemporaryDirectory() as folder:
        for path in recordings:
            for warning in convert(path, table := Path(folder, "run.csv")):
                print(warning, file=sys.stderr)
            frames.append(pd.read_csv(table, dtype={"detail": str, "name": str}).assign(run=path.stem))
    frame = pd.concat(frames, ignore_index=True).dropna(subset=["robot"])  # without how runs ended
    frame["activity"] = frame["name"].fillna("").where(frame["name"].fillna("") != "", frame["element"])
    frame["case:concept:name"] = frame[CASE].astype(str).agg("/".join, axis=1)
    frame[TIME] = pd.to_datetime(frame["time"], unit="s", utc=True)
    return frame


def bodies(process: Any) -> Iterator[tuple[str, Any]]:
    """The diagram of a process and those of its sub-processes, with their names."""
    yield process.name or process.id, process.body
    for node in process.body.walk():
        if node.body is not None:
            yield node.name or node.id, node.body


def compare(name: str, body: Any, events: pd.DataFrame) -> bool:
    """Print how well the log of a diagram fits it, and the model that is discovered from it; whether there is one."""
    visible = frozenset(node.id for node in body.nodes if has_events(node))
    log = events[(events["what"] == "leave") & events["element"].isin(visible)]
    cases = log["case:concept:name"].nunique()
    if not cases:
        print(f"{name}: never executed")
        return False
    log = log.assign(**{"concept:name": log["activity"]})[["case:concept:name", "concept:name", TIME]]
    drawn = Net(body, visible)
    nets = {"drawn": (drawn.net, *drawn.markings), "discovered": pm4py.discover_petri_net_inductive(log)}
    print(
        f"{name}: {cases} executions, {log.groupby('case:concept:name')['concept:name'].agg(tuple).nunique()} variants"
    )
    for kind, net in nets.items():
        fitness = pm4py.fitness_token_based_replay(log, *net)
        precision = pm4py.precision_token_based_replay(log, *net)
        whole = fitness["percentage_of_fitting_traces"]
        print(f"  {kind:<10} fitness {fitness['log_fitness']:.3f} ({whole:.1f} % fit), precision {precision:.3f}")
    for activity, seconds in durations(events, visible).items():
        times, median, longest = (seconds[key] for key in ("count", "50%", "max"))
        print(f"  {activity:<24} {times:5.0f} times, median {median:6.1f} s, longest {longest:6.1f} s")
    return True


def has_events(node: Any) -> bool:
    """Whether the executions of a node are in those of its diagram: not those of gateways, which say nothing more, and
    those that are executions of their own (repeated sub-processes, event sub-processes)."""
    apart = getattr(node, "loop", None) is not None or (node.body is not None and node.kind == "event")
    return not node.tag.endswith("Gateway") and not apart


def durations(events: pd.DataFrame, elements: frozenset[str]) -> dict[str, Any]:
    """The three activities that took most time altogether: how often, and the seconds of one."""
    rows = events[events["element"].isin(elements) & events["what"].isin(["enter", "leave"])]
    lengths = rows.groupby(["case:concept:name", "element"])["time"].diff()[rows["what"] == "leave"]
    found = (
        lengths.groupby(rows["activity"])
        .describe(percentiles=[0.5])
        .assign(total=lambda one: one["mean"] * one["count"])
    )
    return dict(found.sort_values("total", ascending=False).head(3).to_dict("index"))


def main() -> None:
    """Compare a model with recordings."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("model", type=Path)
    parser.add_argument("recordings", type=Path, help="a recording (.mcap), or a folder of them")
    arguments = parser.parse_args()
    found = sorted(arguments.recordings.rglob("*.mcap")) if arguments.recordings.is_dir() else [arguments.recordings]
    if not found:
        sys.exit(f"{arguments.recordings}: has no recordings (.mcap)")
    try:
        processes, events = fame.read(arguments.model).processes, events_of(found)
    except fame.FameError as error:
        sys.exit(str(error))
    executed = [compare(name, body, events) for process in processes for name, body in bodies(process)]
    if not any(executed):
        sys.exit(
            f"{arguments.recordings}: nothing of {arguments.model} was executed: expected recordings of this model"
        )


if __name__ == "__main__":
    main()
