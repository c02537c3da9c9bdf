"""The modules of the page by themselves, without a browser: `tests/page/*.test.mjs`, run by node's own test runner."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent / "page"


@pytest.mark.node
@pytest.mark.parametrize("name", sorted(path.name for path in FOLDER.glob("*.test.mjs")))
def test_of_the_page_alone(name: str) -> None:
    if shutil.which("node") is None:
        pytest.skip("needs the program node, 20.19 or later: make test-node")
    command = ["node", "--disable-warning=MODULE_TYPELESS_PACKAGE_JSON", "--test", str(FOLDER / name)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stdout + ended.stderr
