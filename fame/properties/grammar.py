"""Parse the sentence of a property. Each method is a rule of the grammar in docs/property_sentences.md."""

from __future__ import annotations

import re
from typing import NamedTuple, NoReturn

from fame.properties.sentence import NOWHERE, Comparison, FieldTest, Location, Occurrence, Property, Value, Verb, Word
from fame.text import suggestion, topic_of

_TOKEN = re.compile(
    r'\s*(?:(?P<text>"(?:[^"\\]|\\.)*")|(?P<topic>~?(?:/[A-Za-z_]\w*)+)|(?P<number>-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)'
    r"|(?P<name>[^\W\d]\w*)|(?P<sign><=|>=|==|!=|[<>,().\[\]]))"
)
_OPERATORS = ("<", "<=", ">", ">=", "==", "!=")
_VERBS = ("starts", "completes", "fails", "is cancelled", "ends", "throws", "catches", "reports")
_UNITS = {"ms": 1e6, "s": 1e9, "min": 60e9, "h": 3600e9}
_GOES_ON = ("within", "until", "before", "only", "each", "at", "with", "and", "where", "after", "times", "time", "most")
"""Words after an event. An element whose id is one of them is in quotation marks."""
STARTS = ("after", "between", "always", "never", "exists", "some")
_LONGEST = 1000
"""Characters of a sentence."""


class _Token(NamedTuple):
    kind: str  # text, topic, number, name, sign; end
    text: str
    offset: int

    @property
    def shown(self) -> str:
        return "the end of the sentence" if self.kind == "end" else repr(self.text)


def quoted(text: str) -> str:
    """Return a text in quotation marks."""
    return '"' + re.sub(r'(["\\])', r"\\\1", text) + '"'


def parse(text: str, place: Location = NOWHERE, name: str = "") -> Property:
    """Read a sentence. `place` is where it begins, `name` that of the property.

    Raises ConfigError with file, line and column of the word that does not fit, and what would.
    """
    return _Parser(text, place, name).sentence()


class _Parser:
    def __init__(self, text: str, place: Location, name: str) -> None:
        self._text, self._place, self._name = text, place, name
        if len(text) > _LONGEST:
            self._fail(0, f"expected a sentence of at most {_LONGEST} characters, got {len(text)}")
        self._tokens, self._at = list(self._split()), 0
        self._after_id, self._same_offset = -1, 0

    # ---- tokens ------------------------------------------------------------------------------------------------------

    def _split(self) -> list[_Token]:
        tokens, at, text = [], 0, self._text.rstrip()
        while at < len(text):
            found = _TOKEN.match(text, at)
            if found is None:
                at += len(text[at:]) - len(text[at:].lstrip())
                closed = "expected a closing quotation mark" if text[at] == '"' else f"unexpected {text[at]!r}"
                self._fail(at, closed)
            kind = str(found.lastgroup)
            tokens.append(_Token(kind, found[kind], found.start(kind)))
            at = found.end()
        return [*tokens, _Token("end", "", len(text))]

    @property
    def _next(self) -> _Token:
        return self._tokens[self._at]

    def _fail(self, offset: int, text: str) -> NoReturn:
        raise self._place.error(text, offset, self._name)

    def _expected(self, what: str, words: tuple[str, ...] = ()) -> NoReturn:
        token = self._next
        asked = bool(words) and token.kind == "name" and token.text not in words
        hint = suggestion(token.text, words) if asked else ""
        close = f"; {hint}" if hint.startswith("did") else self._mistyped()
        self._fail(token.offset, f"expected {what}, got {token.shown}{close}")

    def _mistyped(self) -> str:
        """Return a hint where the word before was read as an id, and resembles a word of the grammar; else nothing."""
        word = self._tokens[self._at - 1].text
        hint = suggestion(word, _GOES_ON) if self._at == self._after_id else ""
        return f"; {word!r} is read as an element: {hint}" if hint.startswith("did") else ""

    def _take(self) -> _Token:
        self._at += 1
        return self._tokens[self._at - 1]

    def _is(self, *words: str) -> bool:
        """Whether these words come next."""
        following = self._tokens[self._at : self._at + len(words)]
        return len(following) == len(words) and all(
            one.text == word and one.kind in ("name", "sign") for one, word in zip(following, words, strict=True)
        )

    def _skip(self, text: str) -> bool:
        """Pass over these words if they come next."""
        words = text.split()
        if self._is(*words):
            self._at += len(words)
            return True
        return False

    def _need(self, text: str, what: str = "") -> None:
        """Pass over these words. Raises ConfigError if others come."""
        for word in text.split():
            if not self._skip(word):
                self._expected(what or f"{text!r}", (word,))

    # ---- sentence ----------------------------------------------------------------------------------------------------

    def sentence(self) -> Property:
        opens = closes = None
        if self._skip("between"):
            opens = self._event()
            self._need("and")
            closes = self._event()
            self._need(",", "',' and what has to hold between these events")
        elif self._skip("after"):
            opens = self._event()
            closes = self._event() if self._skip("until") else None
            self._need(",", "',' and what has to hold after this event")
        parts = self._pattern()
        if self._is("until") or self._is("before"):
            if closes is not None or ("before" in parts) or self._is("before"):
                self._expected("the end of the sentence")
            self._take()
            closes = self._event()
        before = parts.pop("before", None)
        if closes is None:
            closes = before  # type: ignore[assignment]
        elif before is not None:
            parts["other"] = before
        if self._next.kind != "end":
            self._expected("the end of the sentence", ("until", "within", "with", "and", "before"))
        made = Property(self._name, self._text, self._place, opens=opens, closes=closes, **parts)  # type: ignore[arg-type]
        self._check_same(made)
        return made

    def _check_same(self, made: Property) -> None:
        """Raise ConfigError where ``with the same`` has no second event, or one without a message."""
        pair = (made.main, made.opens if made.pattern == "exists" else made.other)
        if made.same and any(each is None or each.verb != "throws" for each in pair):
            self._fail(self._same_offset, "with the same FIELD needs two events that throw a message")

    def _pattern(self) -> dict[str, object]:
        if self._skip("always"):
            return {"pattern": "always", "condition": self._condition()}
        if self._skip("never"):
            return self._never()
        if self._skip("exists"):
            return self._existence(self._event())
        main = self._event(STARTS)
        if self._skip("only after"):
            return {"pattern": "only after", "main": main, "other": self._event()}
        if self._skip("each"):
            self._need("time only after")
            return {"pattern": "each time only after", "main": main, "other": self._event(), "same": self._same()}
        if self._skip("at"):
            self._need("most")
            number = self._take() if self._next.text.isdecimal() else self._expected("a whole number of times")
            if not (self._skip("times") or self._skip("time")):
                self._expected("'times'")
            return {"pattern": "at most", "main": main, "count": int(number.text)}
        return self._existence(main)

    def _never(self) -> dict[str, object]:
        if self._is_condition():
            return {"pattern": "never", "condition": self._condition()}
        parts: dict[str, object] = {"pattern": "never", "main": self._event()}
        return {**parts, "before": self._event()} if self._skip("before") else parts

    def _existence(self, main: Occurrence) -> dict[str, object]:
        bound = self._duration() if self._skip("within") else None
        return {"pattern": "exists", "main": main, "bound": bound, "same": self._same()}

    def _same(self) -> tuple[str | int, ...]:
        if not self._is("with"):
            return ()
        self._same_offset = self._next.offset
        self._need("with the same")
        return self._path(self._name_of("a field of both messages"))

    def _duration(self) -> int:
        number = self._take() if self._next.kind == "number" else self._expected("a time, as in 12 s")
        if self._next.text not in _UNITS:
            self._expected(f"a unit ({', '.join(_UNITS)})")
        bound = float(number.text) * _UNITS[self._take().text]
        if not 0.5 < bound < 1e18:
            limit = "above 0" if bound < 1 else "below 30 years"
            self._fail(number.offset, f"expected a time {limit}, got {number.text}")
        return round(bound)

    # ---- events ------------------------------------------------------------------------------------------------------

    def _event(self, others: tuple[str, ...] = ()) -> Occurrence:
        first = self._next
        some = self._skip("some")
        if self._next.kind not in ("name", "text"):
            self._expected("a robot or pool")
        quoted = self._next.kind == "text"
        robot = self._robot()
        after = self._next
        found = next((verb for verb in _VERBS if self._skip(verb)), None)
        if found is None:
            if others and suggestion(robot.text, others).startswith("did"):
                self._at -= 1
                self._expected("always, never, exists, after, between or an event", others)
            if after.text in (".", "("):
                self._fail(robot.offset, "expected an event here; a condition follows always or never")
            words = "" if quoted or after.kind == "end" else "; a name of several words is in quotation marks"
            self._expected(f"what {robot.text} does ({', '.join(_VERBS)}{words})", _VERBS)
        made = self._object(found, robot, some)  # type: ignore[arg-type]
        text = self._text[first.offset : self._end()]
        return Occurrence(robot, *made[:2], some, *made[2:], text=text)

    def _end(self) -> int:
        last = self._tokens[self._at - 1]
        return last.offset + len(last.text)

    def _object(self, verb: Verb, robot: Word, some: bool) -> tuple[Verb, Word, str | None, tuple[FieldTest, ...]]:
        """Verb, target, error code and conditions of an event."""
        if verb in ("throws", "catches"):
            if self._next.kind not in ("topic", "text"):
                self._expected('a topic, as in /weed_found or "Weed found"')
            topic = self._quoted() if self._next.kind == "text" else Word(self._next.text, self._take().offset)
            where = self._where(verb) if self._is("where") else ()
            return verb, Word(topic_of(topic.text), topic.offset), None, where
        if verb == "reports":
            return verb, self._quoted() if self._next.kind == "text" else Word("", robot.offset), None, ()
        located = verb in ("fails", "is cancelled") and not self._is("at", "most") and self._skip("at")
        target = self._element()
        if located and not target.text:
            self._expected("an element, by label or id")
        code = None
        if verb == "fails" and self._is("with") and self._tokens[self._at + 1].kind == "text":
            if not target.text:
                text = "an error code needs an element that fails: of a robot that fails, the code is not recorded"
                self._fail(self._next.offset, text)
            self._take()
            code = self._quoted().text
        return verb, target, code, ()

    def _element(self) -> Word:
        token = self._next
        if token.kind == "text":
            return self._quoted()
        if token.kind == "name" and token.text not in _GOES_ON:
            self._take()
            self._after_id = self._at
            return Word(token.text, token.offset)
        return Word("", token.offset)

    def _quoted(self) -> Word:
        token = self._take()
        return Word(re.sub(r"\\(.)", r"\1", token.text[1:-1]), token.offset)

    def _where(self, verb: Verb) -> tuple[FieldTest, ...]:
        if verb == "catches":
            self._fail(self._next.offset, "only throws takes a condition: which message was caught is not recorded")
        self._take()
        tests = [self._field_test()]
        while self._is("and") and self._at + 2 < len(self._tokens) and (
            self._tokens[self._at + 2].text in (*_OPERATORS, ".", "[")
        ):  # fmt: skip
            self._take()
            tests.append(self._field_test())
        return tuple(tests)

    def _field_test(self) -> FieldTest:
        offset = self._next.offset
        path = self._path(self._name_of("a field of the message"))
        return FieldTest(path, self._operator(), self._constant(), offset)

    # ---- conditions --------------------------------------------------------------------------------------------------

    def _is_condition(self) -> bool:
        first, second = self._next, self._tokens[min(self._at + 1, len(self._tokens) - 1)]
        return first.kind in ("topic", "number") or (second.kind == "sign" and second.text in (".", "(", *_OPERATORS))

    def _condition(self) -> tuple[Comparison, ...]:
        found = [self._comparison()]
        while self._skip("and"):
            found.append(self._comparison())
        return tuple(found)

    def _comparison(self) -> Comparison:
        start = self._next
        made = Comparison(self._value(), self._operator(), self._value())
        if made.left.kind == made.right.kind == "constant":
            self._fail(start.offset, "expected a value of the team in this comparison, got two constants")
        return made

    def _operator(self) -> str:
        if self._next.text not in _OPERATORS or self._next.kind != "sign":
            self._expected(f"one of {' '.join(_OPERATORS)}")
        return self._take().text

    def _value(self) -> Value:
        token = self._next
        named = self._tokens[self._at + (token.kind != "end")].text == "."
        if not named and (token.kind in ("number", "text") or token.text in ("true", "false")):
            return Value("constant", Word(token.text, token.offset), constant=self._constant())
        if token.kind == "topic":
            self._take()
            if self._next.text != ".":
                self._expected("'.' and a field of the message")
            return Value("topic", Word(token.text, token.offset), self._path(""))
        if self._is("distance", "("):
            return self._distance()
        robot = self._robot("a value: ROBOT.variable, ROBOT.battery, /topic.field, distance(A, B) or a number").text
        self._need(".", f"'.' and a variable of {robot}")
        name = self._name_of("a variable")
        if name == "battery":
            return Value("battery", Word(robot, token.offset))
        return Value("variable", Word(robot, token.offset), self._path(name))

    def _distance(self) -> Value:
        start = self._take()
        self._take()
        any_two = self._skip("any two")
        one, other = self._robot(), None
        if not any_two:
            self._need(",", "',' and a second robot")
            other = self._robot()
            if other.text == one.text:
                self._fail(other.offset, f"expected another robot, or distance(any two {one.text}) for those of a pool")
        self._need(")")
        return Value("distance", one._replace(offset=one.offset or start.offset), other=other)

    def _robot(self, what: str = "a robot") -> Word:
        """The name of a robot or pool: a word, or any text in quotation marks."""
        token = self._next
        return self._quoted() if token.kind == "text" else Word(self._name_of(what), token.offset)

    def _name_of(self, what: str) -> str:
        if self._next.kind != "name":
            self._expected(what)
        return self._take().text

    def _path(self, first: str) -> tuple[str | int, ...]:
        """The rest of a path: names after dots, list indices in brackets."""
        path: list[str | int] = [first] if first else []
        while self._is(".") or self._is("["):
            if self._take().text == ".":
                path.append(self._name_of("a field"))
            else:
                number = self._take() if self._next.text.isdecimal() else self._expected("the index of a list")
                path.append(int(number.text))
                self._need("]")
        return tuple(path)

    def _constant(self) -> float | str | bool:
        token = self._next
        if token.kind == "number":
            return float(self._take().text)
        if token.kind == "text":
            return self._quoted().text
        if token.text in ("true", "false"):
            return self._take().text == "true"
        self._expected("a number, a text in quotation marks, true or false")
