"""Explain why a token waits: the lines of ``fame status --why``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from fame.clock import SECOND
from fame.dataclasses import dataclass
from fame.errors import DeploymentError, ModelError, display_name
from fame.log.elements import UNKNOWN, element_info
from fame.robot.robot_state import RobotState
from fame.robot.wait_sentences import sentence, value_text
from fame.robot.waiting_tokens import silence_text
from fame.text import printable, suggestion

if TYPE_CHECKING:
    from fame.bpmn.model import Definitions


@dataclass(frozen=True, slots=True)
class WaitReason:
    """A waiting token: its entry in ``/fame/waiting``, the label of its element, the values that its conditions read.

    `path`: ids of the activities that it is inside; `seconds`: for how long it has waited; `now`: ns of the robot's
    clock.
    """

    token: Mapping[str, Any]
    path: Sequence[str]
    label: str
    values: Mapping[str, Any]
    seconds: float
    now: int

    def lines(self, robot: str) -> Iterator[str]:
        """Yield the reason in words."""
        path = "".join(f" in {inner}" for inner in reversed(self.path))
        where = display_name(self.token["element"], self.label)
        yield printable(f"{robot} waits at {where}{path}, for {self.seconds:.1f} s, for {wait_text(self.token)}")
        if text := suspension(self.token):
            yield printable(f"  it is {text}")
        for condition in self.token.get("conditions", ()):
            yield printable(f"  {sentence('not_true', text=condition['text'])}")
            for name in condition["reads"]:
                yield printable(f"    {value_text(name, self.values, repr)}")
        for topic in self.token.get("topics", ()):
            nodes = self.token.get("publishers", {}).get(topic, ())
            by = sentence("published", nodes=", ".join(nodes)) if nodes else sentence("unpublished")
            yield printable(f"  {topic} {by}")
        yield from (f"  {text}" for text in silences(self.token, self.now))
        for text in self.token.get("mismatches", ()):
            yield printable(f"  {text}")
        missed = self.token.get("missed")
        if missed is not None:
            last = sentence("last", ago=f"{max(0.0, (self.now - missed['time']) / SECOND):.1f} s")
            yield printable(f"  {last} and {sentence('missed', why=missed['why'])}")
        elif self.token.get("topics"):
            yield f"  {sentence('no_message')}"

    def to_json(self) -> dict[str, Any]:
        """Return the same as data."""
        return {
            **self.token,
            "path": list(self.path),
            "label": self.label,
            "values": dict(self.values),
            "seconds": round(self.seconds, 3),
        }


def wait_text(token: Mapping[str, Any]) -> str:
    """Return what a token waits for."""
    for kind in ("service", "action"):
        if kind in token:
            return sentence(kind, name=token[kind])
    return str(token.get("text") or token.get("kind", "something"))


def suspension(token: Mapping[str, Any]) -> str:
    """Return who suspends a token; empty if nobody does."""
    return sentence("suspended", by=token.get("by") or sentence("event_subprocess")) if token.get("suspended") else ""


def silences(token: Mapping[str, Any], now: int) -> list[str]:
    """Return what is to be said, at `now` (ns), of a server that has gone, or says nothing."""
    return [silence_text(kind, token[kind], now) for kind in ("gone", "silent") if kind in token]


def explain(state: RobotState, model: Mapping[str, Any], element: str, now: int) -> list[WaitReason]:
    """Return why the tokens of a robot wait, or those at an element (id or label). `now`: ns of the robot's clock.

    Raises DeploymentError if no token waits at that element.
    """
    infos = element_info(files_of(model))
    reasons = []
    for token in state.tokens.values():
        label = infos.get(token["element"], UNKNOWN).name
        if element and element not in (token["element"], label):
            continue
        known = state.visible(token["scope"])
        names = {name for condition in token.get("conditions", ()) for name in condition["reads"]}
        values = {name: known[name] for name in sorted(names) if name in known}
        seconds = max(0.0, (now - token["since"]) / SECOND)
        reasons.append(WaitReason(token, state.path(token["scope"]), label, values, seconds, now))
    if element and not reasons:
        ids = {token["element"] for token in state.tokens.values()}
        there = sorted((ids | {infos.get(id, UNKNOWN).name for id in ids}) - {""})
        raise DeploymentError(f"no token waits at {element!r}; {suggestion(element, there)}")
    return reasons


def files_of(model: Mapping[str, Any]) -> list[Definitions]:
    """Return the files that a robot runs, as its ``bpmn_model`` says; without those that cannot be read."""
    from fame.bpmn import read_text

    files = []
    for each in model.get("models", ()):
        with suppress(ModelError, KeyError):
            files.append(read_text(str(each["xml"]), file=str(each["name"])))
    return files
