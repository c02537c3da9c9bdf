"""Where a run went, read back from its log."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TextIO

from fame.errors import ConfigError


def visits(path: str | Path) -> Counter[str]:
    """How often a token came to each element and took each flow, from a .jsonl or .csv log.

    Raises ConfigError if the file is no such log.
    """
    path = Path(path)
    rows = _ROWS.get(path.suffix.lower())
    if rows is None:
        raise ConfigError(f"found the ending {path.suffix!r}; {' or '.join(_ROWS)} would be right", file=str(path))
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            return Counter(row["element"] for row in rows(stream) if row["what"] in ("enter", "take"))
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, LookupError, TypeError, AttributeError, csv.Error):
        raise ConfigError("is no log of a run, as fame run --log writes it", file=str(path)) from None


_ROWS: Mapping[str, Callable[[TextIO], Iterable[Mapping[str, Any]]]] = {
    ".jsonl": lambda stream: map(json.loads, stream),
    ".csv": csv.DictReader,
}
