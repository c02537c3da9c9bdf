"""Puts the pages of `docs` into a wheel, which `fame docs --text` shows: without their pictures, which it cannot."""

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Pages(BuildHookInterface):  # type: ignore[type-arg]
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the pages."""
        pages = Path(self.root, "docs").glob("*.md")
        build_data["force_include"].update({str(page): f"fame/docs/{page.name}" for page in pages})
