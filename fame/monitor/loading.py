"""Services that take long to load, beside the mission that starts them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar

from fame.gc_tuning import uncollected
from fame.robot.services import RunningService, ServiceContext

_Loaded = TypeVar("_Loaded")


class LoadingService(Generic[_Loaded]):
    """A service whose libraries and files are loaded beside the engine, which goes on meanwhile.

    load     gives what takes long to load, in a worker (`fame.worker`)
    start    makes the service of it, in the thread of the engine
    discard  gets what was loaded if the service was closed meanwhile

    Raises what `load` and `start` raise, if these are done at once; else `results` does.
    """

    def __init__(
        self,
        context: ServiceContext,
        load: Callable[[], _Loaded],
        start: Callable[[_Loaded], RunningService],
        discard: Callable[[_Loaded], object] = lambda loaded: None,
    ) -> None:
        self._changed, self._start, self._discard = context.changed, start, discard
        self._service: RunningService | None = None
        self._error: Exception | None = None
        self._begun = self._closed = False
        self._worker = context.scheduler.worker("fame service")
        self._worker.call(uncollected()(load), self._on_loaded)
        if self._error is not None:
            raise self._error
        self._begun = True

    def results(self) -> Mapping[str, Any] | None:
        """Return those of the service, None while it is loaded."""
        if self._error is not None:
            raise self._error
        return self._service.results() if self._service is not None else None

    def close(self) -> None:
        """End the service. What is still being loaded is discarded then: nothing interrupts an import safely."""
        self._closed = True
        if self._service is not None:
            self._service.close()

    def _on_loaded(self, loaded: Any, error: Exception | None) -> None:
        self._worker.close()  # it has nothing left to do
        if self._closed:
            if error is None:
                self._discard(loaded)
            return
        try:
            if error is not None:
                raise error
            self._service = self._start(loaded)
        except Exception as reason:
            self._error = reason
        if self._begun:
            self._changed()
