"""What all processes of a team have in common, read before anything of them is left out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set

from fame.bpmn import model
from fame.bpmn.topics import TopicUse
from fame.check.explore.aliases import Aliases
from fame.check.explore.counting import counted_lists
from fame.check.explore.error_codes import caught_codes
from fame.check.explore.slicing import unknown_variables
from fame.dataclasses import dataclass
from fame.scripting.effects import Effects, computed_topics, script_effects


@dataclass(frozen=True, slots=True)
class TeamFacts:
    """Facts about the processes of a team.

    types    the topics of the team
    shared   those that one robot may send and another, or itself, may take
    outside  those that may come at any time
    called   processes that calls lead to
    counted  variables with lists of which only the length is read
    unknown  variables whose values are certainly unknown
    aliases  variables that may hold the same list or mapping
    coarse   the same and more, for what may count as changed to have fewer states
    late     variables that functions of JavaScript may set at any time, "" for all
    leaked   variables whose values functions may change that a script has left, see `Aliases.holders`
    catches  the codes that error events catch; "": any
    escalations  the codes of escalations that are caught
    named    the error codes that properties name
    read     the variables that properties read
    """

    types: Mapping[str, TopicUse]
    shared: frozenset[str]
    outside: frozenset[str]
    called: frozenset[str]
    counted: frozenset[str]
    unknown: frozenset[str]
    aliases: Aliases
    coarse: Aliases
    leaked: frozenset[str]
    late: frozenset[str]
    catches: frozenset[str]
    escalations: frozenset[str]
    named: frozenset[str]
    read: frozenset[str]

    @property
    def codes(self) -> tuple[str, ...]:
        """The error codes that somebody names, of which an unknown one may be any."""
        return tuple(sorted((self.catches | self.named) - {""}))


def facts_of(
    processes: Iterable[model.Process],
    types: Mapping[str, TopicUse],
    *,
    given: bool,
    read: frozenset[str],
    parameters: Set[str],
    named: frozenset[str],
) -> TeamFacts:
    """Return the facts about the processes of a team; the arguments are those of `abstraction`."""
    processes = [*processes]
    thrown, caught = set[str](), set[str]()
    for topic, throws in (end for process in processes for end in ends_of(process)):
        (thrown if throws else caught).add(topic)
    from_outside = caught - thrown
    computed = computed_topics((node for process in processes for node in process.body.walk()), "publish")
    bodies = [body for process in processes for body in process.body.bodies()]
    aliases = Aliases(bodies)
    left = {name for one in processes for node in one.body.walk() for name in script_effects(node).leaves}
    return TeamFacts(
        types=types,
        shared=frozenset(topic for topic in thrown & caught if topic[0] == "/"),
        # A robot's own topics ("~") are its sensors', whatever it sends on them itself.
        # A script may be left out that computes the names of those that it throws.
        outside=frozenset(from_outside | {topic for topic in caught if topic[0] == "~" or topic.startswith(computed)}),
        called=frozenset(call.called for process in processes for call in process.body.calls()),
        counted=counted_lists(processes) - read,
        # A state that is given may hold a value that nothing in the model explains.
        unknown=frozenset() if given else unknown_variables(processes, from_outside, parameters),
        aliases=aliases,
        coarse=Aliases(bodies, coarse=True),
        leaked=frozenset(left.union(*(aliases.of((name, False)) for name in left))),
        late=frozenset(
            name for one in processes for node in one.body.walk() for name in _set_late(script_effects(node))
        ),
        catches=caught_codes(processes, model.ErrorDefinition),
        escalations=caught_codes(processes, model.EscalationDefinition) - {""},
        named=named,
        read=read,
    )


def _set_late(effects: Effects) -> frozenset[str]:
    """What a script in JavaScript may set when it is over."""
    return effects.later if effects.calls is not None else frozenset()


def ends_of(process: model.Process) -> Iterator[tuple[str, bool]]:
    """Yield (topic, whether it is thrown) of the events and scripts of a process."""
    for node in process.body.walk():
        for topic, throws in node.topics():
            yield topic.qualified, throws
        for used in script_effects(node).topics:
            if used.direction in ("publish", "subscribe"):
                yield used.qualified, used.direction == "publish"
