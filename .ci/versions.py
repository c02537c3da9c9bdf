"""Compare what is installed with `.ci/constraints.txt`: the versions that the tests ran with, which `.ci/run` installs.

``python .ci/versions.py`` prints each difference and always succeeds: ``VERSIONS=newest .ci/run`` tries newer ones.
``python .ci/versions.py --write`` writes the versions that are installed.
"""

from __future__ import annotations

import platform
import re
import sys
from importlib.metadata import distributions
from pathlib import Path

FILE = Path(__file__).with_name("constraints.txt")
HEAD = """\
# The versions that the tests ran with, on Python {python}. To install them:
# pip install -c .ci/constraints.txt -e '.[dev]'
# Written by: python .ci/versions.py --write
"""
OURS = {"fame-robots", "pip", "setuptools"}


def installed() -> dict[str, str]:
    """Give the version of each package here, but for our own and those of every environment."""
    found = {re.sub("[-_.]+", "-", one.metadata["Name"]).lower(): one.version for one in distributions()}
    return {name: version for name, version in sorted(found.items()) if name not in OURS}


def locked() -> dict[str, str]:
    """Give the versions of the file."""
    lines = FILE.read_text(encoding="utf-8").splitlines()
    return dict(line.split("==") for line in lines if "==" in line and not line.startswith("#"))


def differences(here: dict[str, str], known: dict[str, str]) -> list[str]:
    """List what differs: ``package 2.0 (the tests ran with 1.0)``."""
    return [
        f"{name} {here.get(name, 'not installed')} (the tests ran with {known.get(name, 'none')})"
        for name in sorted(here.keys() | known.keys())
        if here.get(name) != known.get(name)
    ]


def main() -> None:
    """Compare or write."""
    here = installed()
    if sys.argv[1:] == ["--write"]:
        text = HEAD.format(python=platform.python_version())
        FILE.write_text(text + "".join(f"{name}=={version}\n" for name, version in here.items()), encoding="utf-8")
        return
    found = differences(here, locked())
    print(f"versions: {len(found)} of {len(here)} packages differ from .ci/constraints.txt")
    for line in found:
        print(f"  {line}")


if __name__ == "__main__":
    main()
