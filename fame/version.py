"""The version of this FAME. Each build has its own: `pip install -U` and reports of faults tell two apart."""

from __future__ import annotations

from functools import cache
from pathlib import Path

RELEASE = "0.3.0"
"""The release that this code leads to, or is: ``package.xml`` repeats it."""
PROTOCOL = 2
"""The protocol of its messages; 1 is that of FAME 0.2, whose messages have no number (docs/deployment.md)."""


@cache
def current() -> str:
    """Return ``RELEASE.devN+gHASH``, for N commits up to HASH, or the release if HASH is tagged ``vRELEASE``.

    A checkout asks git, an installation has what it was built from. Where neither is known: ``RELEASE.dev0``.
    """
    folder = Path(__file__).parent.parent
    if (folder / ".git").exists():
        return of_checkout(folder) or f"{RELEASE}.dev0"
    built = folder / "fame" / "BUILD"
    return built.read_text(encoding="utf-8").strip() if built.exists() else f"{RELEASE}.dev0"


def differs(robot: str, protocol: int, fame: str = "") -> str:
    """Return what to say of a robot that speaks another protocol; nothing of one that speaks this one."""
    if protocol == PROTOCOL:
        return ""
    what = f"FAME {fame}" if fame else "an older FAME" if protocol < PROTOCOL else "a newer FAME"
    mend = f"update {robot}" if protocol < PROTOCOL else "update FAME here"
    other = f"use what {what} has" if protocol < PROTOCOL else f"the FAME of {robot}"
    return f"{robot} runs {what} (protocol {protocol}); this speaks {PROTOCOL}: {mend}, or {other}"


def of_checkout(folder: Path) -> str:
    """Return the version of a checkout (PEP 440); empty without git, or where git refuses the folder."""
    import subprocess

    def git(*words: str) -> str:
        command = ["git", "-C", str(folder), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    try:
        if f"v{RELEASE}" in git("tag", "--points-at", "HEAD").split():
            return RELEASE
        return f"{RELEASE}.dev{git('rev-list', '--count', 'HEAD')}+g{git('rev-parse', '--short=8', 'HEAD')}"
    except (OSError, subprocess.CalledProcessError):
        return ""


def __getattr__(name: str) -> str:
    if name == "__version__":
        return current()
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
