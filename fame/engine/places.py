"""Where the tokens of a state are in another program: each in the scope that its element is in there.

An element may have moved into a sub-process, or out of one. As in Camunda's migration, the token then leaves the scopes
around it and new ones are made, but only where the state that this gives is the only one: the scopes that it leaves
hold no other token and nothing that their end would have to pass on or undo; one token enters a new scope, to which
nothing has to be assigned. `Places.place` raises `Misplaced` otherwise.

What a scope has of its own follows from its nodes: `fame.engine.migration.arm_new` arms it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from fame.bpmn import model
from fame.engine.compensation import UNDO
from fame.engine.encoding import Data
from fame.engine.program import Body, Node, Program

_PLAIN = ("embedded", "transaction")
Owner = model.Process | model.SubProcess


class Misplaced(Exception):
    """A token that cannot get to its place; the text says why."""


class Places:
    """The scopes, waits and mailboxes of a state, by key, while tokens are placed.

    before  the elements of the old program
    gone    keys of what is dropped
    made    the keys of new scopes; their nodes are those of the new program already
    left    for each scope that its only token left: that token
    routes  for each scope that a token left: the scopes that its events may be in now
    """

    def __init__(self, data: Data, old: Program, new: Program, node: Callable[[str | None], str | None]) -> None:
        self._old, self._new, self._node = old, new, node
        self.scopes: dict[int, Data] = {
            item["key"]: {**item, "children": list(item["children"]), "mail": item["mail"] and list(item["mail"])}
            for item in data["scopes"]
        }
        self.waits: dict[int, Data] = {item["key"]: dict(item) for item in data["waits"]}
        self.boxes: dict[int, Data] = {item["key"]: dict(item) for item in data["boxes"]}
        self.counter: int = data["counter"]
        self.gone, self.made, self.left = set[int](), list[int](), dict[int, int]()
        self._routes: dict[int, list[int]] = {}
        self._running = int(bool(data["held"]))
        self.before: dict[str, model.FlowNode] = {n.id: n for process in old.sources for n in process.body.walk()}
        self._homes: dict[str, Owner] = {}
        for process in new.sources:
            for owner in (process, *(node for node in process.body.walk() if isinstance(node, model.SubProcess))):
                self._homes.update((each.id, owner) for each in (*owner.body.nodes, *owner.body.flows))
        self._now = {node.id: node for process in new.sources for node in process.body.walk()}

    # ---- nodes and bodies --------------------------------------------------------------------------------------------

    def node_of(self, item: Data) -> Node | None:
        """Return the node that a wait or scope has in the new program."""
        key = item["node"] if item["key"] in self.made else self._node(item["node"])
        return self._new.by_key.get(key or "")

    def arming(self, item: Data) -> tuple[Node, ...]:
        """Return what a token arms in the new program: boundary events, starts of event sub-processes."""
        node, body = self.node_of(item), self.body(item) if item["key"] in self.scopes else None
        boundary = node.boundary.armed if node is not None and node.boundary is not None else ()
        return (*boundary, *(body.armed if body is not None else ()))

    def around(self, key: int | None) -> Iterator[int]:
        """Yield the key of a wait or scope, and those of the scopes around it."""
        while key is not None:
            yield key
            key = self.scopes[key]["parent"] if key in self.scopes else self.waits[key]["scope"]

    def successor(self, key: int) -> int | None:
        """Return the token that is now in the place of a token: itself, or what has left it; None if it is gone."""
        while key in self.left:
            key = self.left[key]
        return None if key in self.gone else key

    def opener(self, scope: Data) -> str | None:
        """Return the key of the new node that opens the body of a scope, "" for the process; None if it has none."""
        body: str | None = scope["body"]
        node = self._old.by_key.get(scope["node"])
        if body is None or scope["key"] in self.made:
            return body
        if scope["handles"]:
            return self._node(scope["handles"][-1])
        if node is not None and node.body is not None and self._old.body_keys[node.body] == body:
            return self._node(node.key)  # not by the body: another call of the same process may call another one now
        return self._node(body) if body else ""

    def body(self, scope: Data) -> Body | None:
        """Return the body that a scope has in the new program."""
        opener = self.opener(scope)
        return self._new.body if opener == "" else self._new.by_key[opener].body if opener is not None else None

    def entry(self, scope: Data, element: str) -> Node | None:
        """Return the first node of an element in a scope."""
        body = self.body(scope)
        if body is not None:
            return body.entries.get(element)
        handlers = (node.boundary.compensation for node in self._new.nodes if node.boundary is not None)
        return next((node.next for node in handlers if node and node.next and node.next.id == element), None)

    def holds(self, scope: Data, element: str) -> bool:
        """Return whether an element of the new program is in the body of a scope, or is what the scope repeats."""
        now, body = self._now.get(element), self.body(scope)
        if scope["body"] is None:
            return scope["node"] != UNDO.key or bool(now and now.for_compensation)
        if body is None or (now is not None and now.for_compensation):
            return False
        return element == body.id or (element in self._homes and self._homes[element].id == body.id)

    def home(self, element: str) -> str:
        """Return the id of the process or sub-process that an element of the new program is in; "" for no such one."""
        return self._homes[element].id if element in self._homes else ""

    def is_handled_in(self, scope: Data, handler: str, before: str | None) -> bool:
        """Return whether an event sub-process handles what a scope is of, or the handler that it interrupted."""
        if scope["node"] == UNDO.key:
            return True
        node = self._node(scope["node"])
        opened = self._new.body if node is None else self._new.by_key[node].body
        home = self._homes.get(handler)
        return home is not None and home.id == (before or (opened.id if opened is not None else ""))

    def is_inside(self, scope: Data, element: str) -> bool:
        """Return whether an element is in the body of a scope, at any depth."""
        body = self.body(scope)
        return body is None or element == body.id or any(owner.id == body.id for owner in self._around(element))

    def _around(self, element: str) -> Iterator[Owner]:
        """Yield what an element is in, inner before outer."""
        while element in self._homes:
            yield self._homes[element]
            element = self._homes[element].id

    # ---- placing -----------------------------------------------------------------------------------------------------

    def place(self, item: Data, parent: int, element: str) -> tuple[int, str]:
        """Move a wait or scope to where an element is. Returns the key of the scope around it, and what that changes.

        Raises Misplaced.
        """
        scope = self.scopes[parent]
        if self.holds(scope, element):
            return parent, ""
        if scope["body"] is None or self._now[element].for_compensation:
            is_handler = self._now[element].for_compensation
            raise Misplaced(f"{element} is {'a' if is_handler else 'no'} compensation handler in the new model")
        around, left = list(self._around(element)), list[Data]()
        ids = [owner.id for owner in around]
        body = self.body(scope)
        while body is None or body.id not in ids:
            self._expect_left(scope, element, ids[0])
            left.append(scope)
            scope = self.scopes[scope["parent"]]
            body = self.body(scope)
        entered = [owner for owner in around[: ids.index(body.id)] if isinstance(owner, model.SubProcess)][::-1]
        self._expect_entered(scope, entered, element)
        route = self._routes.setdefault(parent, [])
        for each in left:
            self._routes[each["key"]] = route
        self._leave(item, left, scope)
        for owner in entered:
            scope = self._make(owner, scope, item)
            route.append(scope["key"])
        route.append(scope["key"])
        said = [f"leaves {self._old.by_key[each['node']].id}, which ends" for each in left]
        said += [f"begins {owner.id} around it" for owner in entered]
        return scope["key"], ", ".join(said)

    def _expect_left(self, scope: Data, element: str, home: str) -> None:
        """Raise Misplaced unless the only token of a scope can leave it without a trace."""
        old = self.before.get(self._old.by_key[scope["node"]].id) if scope["node"] in self._old.by_key else None
        if old is None:
            raise Misplaced(f"{element} is in {home} in the new model, and its token is in another process")
        text = f"{element} is in {home} in the new model, and its token is in {old.id}"
        plan = f"; {old.id}: {{to: ID}} in the plan ends that"
        if not isinstance(old, model.SubProcess) or old.kind not in _PLAIN or old.loop is not None or scope["handles"]:
            raise Misplaced(f"{text}, which is no plain sub-process that it could leave{plan}")
        if scope["tokens"] > 1:
            raise Misplaced(f"{text} with {scope['tokens'] - 1} more{plan}")
        if scope["state"] != self._running:
            raise Misplaced(f"{text}, which is suspended")
        if scope["done"]:
            raise Misplaced(f"{text}, in which activities have completed that can be compensated{plan}")
        if scope["variables"] != self.scopes[scope["parent"]]["variables"]:
            raise Misplaced(f"{text}, which has variables of its own{plan}")

    def _expect_entered(self, scope: Data, entered: list[model.SubProcess], element: str) -> None:
        """Raise Misplaced unless some sub-processes can be begun around a token in a scope, the outer one first."""
        body = self.body(scope)
        assert body is not None
        if body.adhoc is not None:
            raise Misplaced(f"{element} is in the ad-hoc sub-process {body.id} in the new model, which has to start it")
        if scope["state"] != self._running:
            raise Misplaced(f"{element} is in another scope in the new model, and its token is suspended")
        for owner in entered:
            text = f"{element} is in {owner.id} in the new model"
            plan = f"; {{to: {entered[0].id}}} in the plan begins that" if owner.kind != "event" else ""
            node = body.entries.get(owner.id)
            if owner.kind not in _PLAIN or owner.loop is not None or owner.for_compensation:
                repeated = "repeated " if owner.loop is not None else ""
                raise Misplaced(f"{text}, which is a {repeated}{owner.kind} sub-process in which no token is{plan}")
            if node is None or node.body is None or node.key != owner.id or node.spec.own:
                raise Misplaced(f"{text}, to which variables are assigned when it begins{plan}")
            body = node.body
        if entered and any(self._is_at(child, entered[0].id) for child in scope["children"]):
            first = entered[0].id
            raise Misplaced(
                f"{element} is in {first} in the new model, in which another token is; "
                f"{{to: {first}}} in the plan begins it once more"
            )

    def _is_at(self, child: int, element: str) -> bool:
        """Return whether a scope is there for an element of the new program."""
        scope = self.scopes.get(child)
        node = self.node_of(scope) if scope is not None and child not in self.gone else None
        return node is not None and node.id == element

    def _leave(self, item: Data, left: list[Data], scope: Data) -> None:
        """Put an item into an outer scope, in the place of the outermost scope that it leaves."""
        self.left.update((each["key"], item["key"]) for each in left)
        if left:
            left[0]["children"].remove(item["key"])
            children = scope["children"]
            children[children.index(left[-1]["key"])] = item["key"]
            self.drop(left[-1])
        self._put(item, scope)

    def _put(self, item: Data, scope: Data) -> None:
        """Set the scope that an item is in, of what is armed for it, too, with its queues."""
        arms = [item]
        for each in arms:  # which grows
            each["parent" if each["key"] in self.scopes else "scope"] = scope["key"]
            if each.get("box") in self.boxes:
                self.boxes[each["box"]]["scope"] = scope["key"]
            self.gone -= {each["key"], each.get("box")}
            arms += (self.waits[key] for key in each["arms"] if key in self.waits)
        inner = [item] if item["key"] in self.scopes else []
        for each in inner:  # which grows
            each["depth"] = self.scopes[each["parent"]]["depth"] + 1
            inner += (self.scopes[key] for key in each["children"] if key in self.scopes)

    def _make(self, owner: model.SubProcess, scope: Data, item: Data) -> Data:
        """Make the scope of a sub-process around an item."""
        body = self.body(scope)
        assert body is not None
        self.counter += 1
        key, node = self.counter, body.entries[owner.id].key
        made = {
            **dict.fromkeys(scope), "key": key, "instance": scope["instance"], "parent": scope["key"], "node": node,
            "body": node, "variables": scope["variables"], "tokens": 1, "state": scope["state"], "mark": 0,
            "depth": scope["depth"] + 1, "children": [item["key"]], "arms": [], "handles": [], "held": [],
        }  # fmt: skip
        self.made.append(key)
        self.scopes[key] = made
        scope["children"][scope["children"].index(item["key"])] = key
        self._put(item, made)
        return made

    def take_over(self, event: Data, key: int) -> bool:
        """Arm an armed event for another token instead. Returns False where only one of the two is suspended."""
        owner = self.scopes.get(event["owner"]) or self.waits[event["owner"]]
        new, is_scope = self.scopes.get(key) or self.waits[key], key in self.scopes
        where = "children" if event["key"] in owner.get("children", ()) else "arms"
        suspended = new["state"] if is_scope else new["paused"]
        if is_scope and new["suspender"] is not None:
            node = self._new.by_key[self._node(event["node"]) or ""]
            suspended -= where == "arms" or not (node.catch and node.catch.resume)
        if event["paused"] != suspended:
            return False
        owner[where] = [each for each in owner[where] if each != event["key"]]
        new[where] = [event["key"], *new[where]]
        event["owner"] = key
        outer = new["parent"] if is_scope else new["scope"]
        self._put(event, new if where == "children" else self.scopes[outer])
        return True

    # ---- what is dropped ---------------------------------------------------------------------------------------------

    def drop(self, item: Data) -> None:
        """Drop a wait or scope with everything in it."""
        dropped = [item]
        for each in dropped:  # which grows
            self.gone.add(each["key"])
            for key in [*each["arms"], *each.get("children", ()), *(each.get("mail") or ()), each.get("box")]:
                inner = self.waits.get(key) or self.scopes.get(key)
                dropped += [inner] if inner is not None else []
                self.gone |= {key} - {None}

    def move_boxes(self) -> None:
        """Move the queues of events that are in another scope now, with what is in them."""
        for key, route in self._routes.items():
            left = self.scopes[key]
            for box in [self.boxes[key] for key in left["mail"] or ()]:
                node = self._new.by_key.get(self._node(box["node"]) or "")
                for scope in (self.scopes[key] for key in route):
                    body = self.body(scope)
                    if body is not None and node in body.queued and scope is not left:
                        left["mail"].remove(box["key"])
                        scope["mail"] = [*(scope["mail"] or ()), box["key"]]
                        box["scope"] = scope["key"]
                        self.gone.discard(box["key"])
                        break
