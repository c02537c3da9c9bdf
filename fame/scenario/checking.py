"""What keeps a scenario from being run: everything is built as for a run, and nothing moves."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fame.check.findings import Finding, of_error
from fame.errors import ConfigError, FameError, ModelError, UnavailableError
from fame.scenario.run import Run
from fame.scenario.scenario import Scenario


def scenario_findings(path: Path, *, library: Sequence[Path] = (), strict: bool = False) -> list[Finding]:
    """The first error of a scenario file, its world and its robots, if there is one; `library` adds folders.

    What `fame.check.check` finds in the model should have been mended before, since its errors are found here too.
    A world that cannot be built for want of a package is a warning.
    """
    try:
        Run(Scenario.load(path, library=library), False, None, None, strict=strict).close()
    except (ConfigError, ModelError) as error:
        return [of_error(error)]
    except UnavailableError as error:
        return [Finding("warning", f"cannot be checked: {error}", str(path))]
    except FameError as error:
        return [Finding("error", str(error), str(path))]
    return []
