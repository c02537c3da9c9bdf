"""What is closed when its block ends."""

from __future__ import annotations

from typing import Self


class Closing:
    """A context manager of what has `close`: files, sockets, threads, processes."""

    def close(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
