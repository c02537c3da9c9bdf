"""The search: all states of a team, breadth first, within a limit; those that need an uncaught error after the others.

An error that nothing catches ends its instance, and the others go on. What follows is explored once all is known that
happens without it, so that the one can be told from the other.
"""

from __future__ import annotations

from fame.check.explore.graph import Errors, Explored
from fame.check.explore.host import OutOfTimeError
from fame.check.explore.product import Product
from fame.check.explore.transitions import FAULTS, Seen, Transition


def explore(product: Product) -> Explored:
    """Find all states; number them in `Product.index`."""
    explored = Explored()
    try:
        _explore(product, explored)
    except OutOfTimeError:
        explored.cut = "seconds"
        del explored.targets[explored.offsets[-1] :]  # of a state that is not explored whole
        explored.layers.append(len(explored.states))
    return explored


def _explore(product: Product, explored: Explored) -> None:
    at, failing = 0, list[_Failing]()
    initial = product.initial()
    for transition in initial:
        _follow(product, explored, -1, transition, failing)
    explored.begun = len(explored.states)
    if len(failing) == len(initial):
        explored.fatal.add(-1)
    while True:
        at = _expand(product, explored, at, failing)
        explored.layers.append(len(explored.states))
        if explored.cut or not failing:
            return
        following, failing = failing, []
        for source, errors, states in following:
            numbers = tuple([add_state(product, explored, source, state) for state in states])
            explored.failures.append((source, errors, numbers))


_Failing = tuple[int, Errors, tuple[int, ...]]
"""(number of a state, errors that nothing catches in a transition from it, states of the team to which that leads)"""


def _expand(product: Product, explored: Explored, at: int, failing: list[_Failing]) -> int:
    """Find all states that follow from those with number `at` and higher, without what fails; gives the next number."""
    options, states, offsets = product.options, explored.states, explored.offsets
    while at < len(states):
        if not at & 255:
            options.progress(len(states), len(states) - at)
        if len(states) > options.limit or (not at & 255 and options.stop()):
            explored.cut = "states" if len(states) > options.limit else "seconds"
            break
        transitions = product.transitions(states[at])
        if options.faults:
            if states[at] >> product.fault_shift & FAULTS:
                transitions = [transition for transition in transitions if not _is_failure(transition)]
            else:
                product.add_faults(states[at], transitions)
        before = len(failing)
        for transition in transitions:
            _follow(product, explored, at, transition, failing)
        offsets.append(len(explored.targets))
        explored.transitions += len(transitions)
        if product.is_final(states[at]):
            explored.final.append(at)
        elif not transitions:
            explored.stuck.append(at)
        elif len(failing) - before == len(transitions):
            explored.fatal.add(at)
        at += 1
    return at


def _follow(product: Product, explored: Explored, at: int, transition: Transition, failing: list[_Failing]) -> None:
    """Note where a transition leads and what it reports."""
    state, _, move, reactions = transition
    if (product.cut or product.network.piles) and product.is_cut(state):
        if at >= 0 and explored.open[-1:] != [at]:
            explored.open.append(at)
        if move.flags is not None or reactions:
            report(product, at, transition)
        return
    settled = product.settled
    after = settled(transition) if settled else (state,)
    if (move.flags is not None or reactions or move.failed) and (errors := report(product, at, transition)):
        failing.append((at, errors, tuple(after)))
        return
    for new in after:
        number = add_state(product, explored, at, new)
        if at >= 0:
            explored.targets.append(number)


def add_state(product: Product, explored: Explored, at: int, state: int) -> int:
    """Return the number of a state that follows on the one with number `at`; it is new if it has none."""
    if product.options.groups:
        state = product.symmetry.canonical(state)
    number = product.index.get(state)
    if number is None:
        number = product.index[state] = len(explored.states)
        explored.states.append(state)
        explored.parents.append(at)
    return number


def report(product: Product, at: int, transition: Transition) -> Errors:
    """Note what a transition reports for the first time; give its uncaught errors, unless a single fault happened."""
    state, robot, move, reactions = transition
    errors: list[tuple[int, str]] = []
    for mover, done in ((robot, move), *reactions):
        if done.flags is not None:
            for kind, what in done.flags:
                product.flags.setdefault((kind, mover, what), Seen(at, transition))
            done.flags = None
        for element in done.failed:
            errors.append((mover, element))
            if done.certain:
                product.certain.add((mover, element))
    return () if state >> product.fault_shift & FAULTS else tuple(errors)


def _is_failure(transition: Transition) -> bool:
    """Whether a step fails by itself, and nothing catches that: a second fault."""
    _, _, move, _ = transition
    kind, _, code = move.stimulus
    return bool(move.failed) and kind == "end" and code is not None
