"""A page of `fame view` in a real browser, without a display: chromium as the system has it, driven by playwright."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from fame.view import PageSource, Server

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

READY = "!!(window.fame && fame.mission.kind && fame.mission.reading >= 1 && fame.store.blocks.every(one => one.data))"


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
    with Server(source) as server:
        context = browser.new_context(viewport={"width": 1280, "height": 720}, reduced_motion="reduce", **options)
        context.add_init_script(f"sessionStorage.getItem('fame-tab') ?? sessionStorage.setItem('fame-tab', '{tab}')")
        page, wrong = context.new_page(), []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda message: wrong.append(message.text) if _is_error(message, blocked, refused) else None)
        page.on("request", lambda one: None if server.address[:17] in one.url else wrong.append(one.url))
        page.goto(server.address)
        until(page, READY)
        try:
            yield page
        finally:
            context.close()
    assert not wrong, wrong


def until(page: Page, condition: str, seconds: float = 60.0) -> Any:
    """Wait until an expression is true on the page, and return its value. One that fails is not true yet.

    The time is ample: a busy machine is no reason to fail. While a block of the run is being loaded there is no state.
    """
    end, wrong = time.monotonic() + seconds, ""
    while time.monotonic() < end:
        value, wrong = page.evaluate(_ATTEMPT, condition)
        if value:
            return value
        page.wait_for_timeout(20)
    raise AssertionError(f"not within {seconds:g} s: {condition} {wrong}")


_BEYOND = """[...document.querySelectorAll('html, body, body *')].filter((one) => {
  const { right, width } = one.getBoundingClientRect();
  const whole = /html|body/.test(one.localName) ? one.scrollWidth : 0;
  return width && Math.max(right - 0.5, whole) > innerWidth;
}).map((one) => `${one.localName}#${one.id}.${one.getAttribute('class')}`)"""


def beyond(page: Page) -> list[str]:
    """What can be seen of the page only by moving it to the side, once it had time to be laid out."""
    found: list[str] = page.evaluate(_BEYOND)
    for _ in range(100):
        if not found:
            break
        page.wait_for_timeout(100)
        found = page.evaluate(_BEYOND)
    return found


def violations(page: Page) -> list[str]:
    """What axe-core has against the page as it is now: rules of WCAG 2.2 and of good practice."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response["violations"]
    return [f"{rule['id']}: {node['html']}" for rule in found for node in rule["nodes"]]


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
