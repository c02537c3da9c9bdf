"""The search: all states of a team, breadth first, within a limit."""

from __future__ import annotations

from fame.check.explore.graph import Explored
from fame.check.explore.product import Product
from fame.check.explore.transitions import FAULTS, Seen, Transition


def explore(product: Product) -> Explored:
    """Find all states; number them in `Product.index`."""
    options, explored, index = product.options, Explored(), product.index
    states, parents, targets, offsets = explored.states, explored.parents, explored.targets, explored.offsets
    sorts, settled = product.symmetry.canonical if options.groups else None, product.settled
    for transition in product.initial():
        if _report(product, -1, transition):
            continue
        for state in settled(transition) if settled else (transition[0],):
            state = sorts(state) if sorts else state
            if state not in index:
                index[state] = len(states)
                states.append(state)
                parents.append(-1)
    at = 0
    while at < len(states):
        if len(states) > options.limit or (not at & 255 and options.stop()):
            explored.cut = "states" if len(states) > options.limit else "seconds"
            break
        found = product.transitions(states[at])
        if options.faults:
            if states[at] >> product.fault_shift & FAULTS:
                found = [transition for transition in found if not _is_failure(transition)]
            else:
                product.add_faults(states[at], found)
        for transition in found:
            _, _, move, reactions = transition
            if (move.flags is not None or reactions or move.failed) and _report(product, at, transition):
                continue
            for new in settled(transition) if settled else (transition[0],):
                state = sorts(new) if sorts else new
                number = index.get(state)
                if number is None:
                    number = index[state] = len(states)
                    states.append(state)
                    parents.append(at)
                elif number == at and move.stimulus[0] not in ("outside", "hear"):
                    explored.loops.append(at)
                targets.append(number)
        offsets.append(len(targets))
        explored.transitions += len(found)
        if product.is_final(states[at]):
            explored.final.append(at)
        elif not found:
            explored.stuck.append(at)
        at += 1
    return explored


def _report(product: Product, at: int, transition: Transition) -> bool:
    """Note what a transition reports for the first time. Whether it ends in an error that nobody catches."""
    _, robot, move, reactions = transition
    failed = False
    for one, done in ((robot, move), *reactions):
        if done.flags is not None:
            for kind, what in done.flags:
                product.flags.setdefault((kind, one, what), Seen(at, transition))
            done.flags = None
        failed |= done.failed
    return failed and not transition[0] >> product.fault_shift & FAULTS


def _is_failure(transition: Transition) -> bool:
    """Whether a step fails by itself, and nothing catches that: a second fault."""
    _, _, move, _ = transition
    kind, _, code = move.stimulus
    return move.failed and kind == "end" and code is not None
