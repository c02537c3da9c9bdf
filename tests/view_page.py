"""A page of `fame view` in a real browser, without a display: chromium as the system has it, driven by playwright."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from fame.view import PageSource, Server

if TYPE_CHECKING:
    from pathlib import Path

    from playwright.sync_api import Browser, Frame, Page

READY = """!!(window.fame && fame.mission.kind && fame.drawing && fame.mission.reading >= 1
  && fame.store.blocks.every(one => one.data))"""


@contextmanager
def opened(
    browser: Browser,
    source: PageSource,
    *,
    tab: str = "diagram",
    blocked: bool = False,
    refused: bool = False,
    **options: Any,
) -> Iterator[Page]:
    """A page with everything loaded, at a tab. Fails if the page had an error or loaded something from elsewhere.

    `blocked`: that its policy has blocked a script of a drawing is no error; `refused`: nor is a refused command.
    """
    with Server(source) as server, _at(browser, server.address, tab, blocked, refused, **options) as page:
        yield page


@contextmanager
def opened_file(browser: Browser, path: Path, *, tab: str = "diagram", **options: Any) -> Iterator[Page]:
    """A page that is a file, opened from the disk without a network. Fails as `opened` does."""
    with _at(browser, path.as_uri(), tab, offline=True, **options) as page:
        yield page


@contextmanager
def _at(
    browser: Browser, address: str, tab: str, blocked: bool = False, refused: bool = False, **options: Any
) -> Iterator[Page]:
    options.setdefault("viewport", {"width": 1280, "height": 720})
    context = browser.new_context(reduced_motion="reduce", **options)
    context.set_default_timeout(60_000)
    context.add_init_script(f"sessionStorage.getItem('fame-tab') ?? sessionStorage.setItem('fame-tab', '{tab}')")
    page, wrong = context.new_page(), []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.on("console", lambda message: wrong.append(message.text) if _is_error(message, blocked, refused) else None)
    here = address if address.startswith("file:") else address[:17]
    page.on("request", lambda one: None if here in one.url else wrong.append(one.url))
    page.goto(address)
    until(page, READY)
    try:
        yield page
    finally:
        context.close()
    assert not wrong, wrong


def until(page: Page | Frame, condition: str, seconds: float = 60.0, *, holds: Callable[[Any], object] = bool) -> Any:
    """Wait until an expression is true on the page, or `holds` of its value, and return that. One that fails is not
    true yet.

    The time is ample: a busy machine is no reason to fail. While a block of the run is being loaded there is no state.
    """
    end, value, wrong = time.monotonic() + seconds, None, ""
    while time.monotonic() < end:
        value, wrong = page.evaluate(_ATTEMPT, condition)
        if not wrong and holds(value):
            return value
        page.wait_for_timeout(20)
    raise AssertionError(f"not within {seconds:g} s: {condition}: {wrong or value}")


def becomes(page: Page, expression: str, expected: object) -> None:
    """Wait until an expression has a value on the page: what is drawn comes a frame or more after its cause."""
    until(page, expression, holds=lambda value: value == expected)


def says(page: Page, css: str, *texts: str) -> None:
    """Wait until the first element of a selector says texts."""
    shown = f"document.querySelector({json.dumps(css)}).innerText.replace(/\\s+/g, ' ')"
    until(page, shown, holds=lambda value: all(text in value for text in texts))


def frames(page: Page) -> None:
    """Wait until the page has drawn what it was to draw."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done))))")


OVERLAPPING = """(boxes) => boxes.filter((a, at) => boxes.slice(at + 1).some((b) =>
  a[0] < b[0] + b[2] && b[0] < a[0] + a[2] && a[1] < b[1] + b[3] && b[1] < a[1] + a[3]))"""
"""Of boxes [x, y, width, height], those that lie on others."""

_BEYOND = """[...document.querySelectorAll('html, body, body :not(svg *)')].filter((one) => {
  const { right, width } = one.getBoundingClientRect();
  const whole = /html|body/.test(one.localName) ? one.scrollWidth : 0;
  return width && Math.max(right - 0.5, whole) > innerWidth;
}).map((one) => `${one.localName}#${one.id}.${one.getAttribute('class')}`)"""


def beyond(page: Page) -> list[str]:
    """What can be seen of the page only by moving it to the side, once it was laid out; diagrams are moved."""
    return _settled(page, lambda: page.evaluate(_BEYOND))


def violations(page: Page) -> list[str]:
    """What axe-core has against the page, once it was drawn: rules of WCAG 2.2 and of good practice."""
    from axe_playwright_python.sync_playwright import Axe

    def look() -> list[str]:
        found = Axe().run(page, options={"resultTypes": ["violations"]}).response["violations"]  # others are long
        return [f"{rule['id']}: {node['html']}" for rule in found for node in rule["nodes"]]

    return _settled(page, look, 5)


def _settled(page: Page, look: Callable[[], list[str]], looks: int = 100) -> list[str]:
    """What is found even when the page has had time to draw."""
    while (found := look()) and (looks := looks - 1):
        page.wait_for_timeout(100)
    return found


def flaws(page: Page, name: str, *looks: tuple[int, str]) -> list[str]:
    """What axe-core has against the page, and what reaches beyond its window, at each width (px) and theme."""
    found = []
    for width, theme in looks:
        page.set_viewport_size({"width": width, "height": 844})
        page.evaluate(f"fame.setTheme('{theme}')")
        frames(page)
        shot(page, f"{name}_{width}")
        found += [f"{width} {theme}: {one}" for one in (*beyond(page), *violations(page))]
    return found


def shot(page: Page, name: str) -> None:
    """Keep a picture in the folder of the environment variable FAME_SHOTS, if there is one."""
    if folder := os.environ.get("FAME_SHOTS"):
        page.screenshot(path=f"{folder}/{name}.png")


class Finger:
    """Fingers on a page with touch: what is more than a tap."""

    def __init__(self, page: Page) -> None:
        self._session = page.context.new_cdp_session(page)

    def put(self, *points: tuple[float, float]) -> None:
        """Lay fingers on points (px)."""
        self._send("touchStart", points)

    def move(self, *points: tuple[float, float]) -> None:
        """Move them there."""
        self._send("touchMove", points)

    def lift(self) -> None:
        """Take them away."""
        self._send("touchEnd", ())

    def _send(self, kind: str, points: Iterable[tuple[float, float]]) -> None:
        given = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(points)]
        self._session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": given})


PHONE: dict[str, Any] = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


_BLOCKED = "Executing inline event handler violates the following Content Security Policy"
_ATTEMPT = """(condition) => {
  try { return [(0, eval)(condition), ""]; } catch (error) { return [false, String(error)]; }
}"""


def _is_error(message: Any, blocked: bool, refused: bool) -> bool:
    expected = (blocked and message.text.startswith(_BLOCKED)) or (refused and "409 (Conflict)" in message.text)
    return message.type == "error" and not expected


def eventually(condition: Callable[[], Any], seconds: float = 60.0) -> Any:
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.02)
    raise AssertionError(f"not within {seconds:g} s")
