"""A model as the last commit has it."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from fame.errors import FameError


def committed(path: Path) -> bytes:
    """Return a file as the last commit of its repository has it. Raises FameError.

    `git cat-file` runs no filter that the repository names, and fetches nothing.
    """
    command = ["git", "-C", str(path.parent), "cat-file", "blob", f"HEAD:./{path.name}"]
    environment = {**os.environ, "GIT_NO_LAZY_FETCH": "1", "LC_ALL": "C"}
    try:
        done = subprocess.run(command, capture_output=True, timeout=10, check=False, env=environment)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FameError(f"git cannot be asked: {getattr(error, 'strerror', None) or error}") from None
    if done.returncode:
        text = done.stderr.decode(errors="replace").strip().removeprefix("fatal: ")
        raise FameError(f"{path}: there is no last commit of it: {text}")
    return done.stdout
