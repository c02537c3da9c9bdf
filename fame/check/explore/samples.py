"""Parts of a team's states that a search may not have reached: one schedule, fewer robots, random runs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator

from fame.bpmn.pools import Pool, all_processes
from fame.check.explore.deliveries import SearchBudget, left_out_of, note_received, report_of, search, steps_end
from fame.check.explore.findings import FAILING, Finding
from fame.check.explore.graph import Explored
from fame.check.explore.host import OutOfTimeError, Stop
from fame.check.explore.product import Delivery, Options, Product
from fame.check.explore.sampling import STEPS, Sampler, durations
from fame.check.explore.team import Team
from fame.dataclasses import replace


def samples(team: Team, stop: Stop) -> Iterator[tuple[str, list[Finding]]]:
    """Explore further parts, and yield the name of each, and what was found in it."""
    steps = max(STEPS, team.request.limit // 20)
    goes_on, left_out, findings = _followed(team, "run", Sampler.schedule, steps, stop)
    followed = (f"followed for {steps:,} steps",) if goes_on and not stop() else ()
    yield ", ".join(("the order of fame run", *followed, *left_out)), findings
    yield from _fewer_robots(team, steps, stop)
    for delivery in team.request.delivery:
        _, left_out, findings = _followed(team, delivery, Sampler.wander, steps, stop)
        yield ", ".join((f"random runs, delivery {delivery}", *left_out)), findings


def _fewer_robots(team: Team, steps: int, stop: Stop) -> Iterator[tuple[str, list[Finding]]]:
    """One robot in each multi-instance pool, then two ..., up to the first error or a search that was not whole."""
    counts = Counter(pool.name for pool in team.cast.values() if pool.multi_instance)
    if team.given:  # a robot that is under way cannot be left out
        return
    for number in range(1, max(counts.values(), default=1)):
        if stop():
            return
        fewer = ", ".join(f"{name}={min(number, count)}" for name, count in counts.items())
        errors, whole = _with_fewer(team, number, steps, stop)
        yield (
            f"fewer robots ({fewer}{'' if whole else ', not all states'})",
            [replace(error, kind="fewer", text=f"with fewer robots ({fewer}): {error.text}") for error in errors],
        )
        if errors or not whole:
            return


def _with_fewer(team: Team, number: int, steps: int, stop: Stop) -> tuple[list[Finding], bool]:
    """Errors of the team with at most `number` robots in each multi-instance pool, and whether these are all."""
    cast, counts = dict[str, Pool](), Counter[str]()
    for robot, pool in team.cast.items():
        counts[pool.name] += 1
        if counts[pool.name] <= number or not pool.multi_instance:
            cast[robot] = pool
    request = replace(team.request, faults=False, samples=False, properties=())
    budget = SearchBudget(steps, stop, stop)
    searched, findings = search(Team(team.definitions, team.library, cast, request), "run", budget)
    errors = [finding for finding in findings if finding.kind in FAILING and not finding.accepted]
    return errors, not (searched.cuts or searched.left_out)


def _followed(
    team: Team, delivery: Delivery, follow: Callable[[Sampler], Explored], steps: int, stop: Stop
) -> tuple[bool, tuple[str, ...], list[Finding]]:
    """Whether some runs would go on, what is left out, and what happens: what never happens cannot be said."""
    product = Product(team.robots, team.locals, Options(delivery=delivery, reduced=False, stop=stop, given=team.given))
    processes = all_processes(team.definitions, team.pools, team.library)
    sampler = Sampler(product, durations(process.body.elements() for _, process in processes), stop, steps)
    with steps_end(team, stop):
        try:
            follow(sampler)
        except OutOfTimeError:
            sampler.close()
    report = report_of(team, product, sampler.explored, stop, exhaustive=False)
    note_received(team, report)
    kinds = (*FAILING, "error", "condition", "dropped")
    findings = [finding for finding in report.findings() if finding.kind in kinds]
    return sampler.bound, left_out_of(report.left_out), findings
