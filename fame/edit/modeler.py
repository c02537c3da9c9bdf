"""The library that draws in the browser: a package of npm, unpacked into the cache of the user when it is its hash.

It is never a part of FAME: its licence asks that the mark of bpmn.io stays visible in each diagram.
"""

from __future__ import annotations

import base64
import hashlib
import io
import os
import tarfile
import tempfile
from pathlib import Path, PurePosixPath
from shutil import rmtree
from urllib.error import URLError
from urllib.request import urlopen

from fame.errors import ConfigError, UnavailableError

NAME, VERSION = "camunda-bpmn-js", "5.35.0"
INTEGRITY = "hT7GB/2vKA4++7oo7E8ZjWgyhFNHnlwP7r61DzrtO4wwYYoeEkulcKNzQKgrVbFIO7/tnV3Wd8cWRPblYu138Q=="
"""SHA-512 of the package, in base64, as npm has it."""
LIMIT = 60_000_000
"""Bytes of the package, and of what it unpacks to each time, at most."""
_PARTS = (
    "LICENSE",
    "dist/assets/",
    "dist/camunda-platform-modeler.production",
    "dist/camunda-cloud-modeler.production",
)


def home() -> Path:
    """Return the folder of the library, whether it is there or not."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(cache, "fame", f"{NAME}-{VERSION}")


def installed() -> Path:
    """Return the folder of the library. Raises UnavailableError if it is not there."""
    if not (home() / "LICENSE").is_file():
        text = f"drawing needs {NAME} {VERSION}: fame edit --fetch, or fame edit --modeler {NAME}-{VERSION}.tgz"
        raise UnavailableError(f"{text}, from npm pack {NAME}@{VERSION}")
    return home()


def fetch() -> Path:
    """Download the package from the registry of npm (or that of NPM_CONFIG_REGISTRY) and unpack it.

    Raises ConfigError if the registry is not reached, or gives something else.
    """
    registry = os.environ.get("NPM_CONFIG_REGISTRY", "https://registry.npmjs.org").rstrip("/")
    address = f"{registry}/{NAME}/-/{NAME}-{VERSION}.tgz"
    if not address.startswith(("https://", "http://")):
        raise ConfigError(f"NPM_CONFIG_REGISTRY: expected an address of the web, got {registry!r}")
    try:
        with urlopen(address, timeout=60) as answer:
            content = answer.read(LIMIT + 1)
    except (URLError, OSError) as error:
        text = f"not downloaded ({getattr(error, 'reason', error)}): where npm works, npm pack {NAME}@{VERSION}"
        raise ConfigError(f"{text}, then fame edit --modeler FILE.tgz", file=address) from None
    return unpack(content, address)


def unpack(content: bytes, file: str) -> Path:
    """Unpack the package into the cache, and return its folder. Raises ConfigError if it is another one."""
    found = base64.b64encode(hashlib.sha512(content).digest()).decode()
    if found != INTEGRITY:
        raise ConfigError(
            f"expected {NAME} {VERSION} with the hash sha512-{INTEGRITY[:12]}…, got {found[:12]}…", file=file
        )
    target = home()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{NAME}-", dir=target.parent))
        try:
            _write(content, made)
            rmtree(target, ignore_errors=True)
            made.rename(target)
        finally:
            rmtree(made, ignore_errors=True)
    except OSError as error:
        raise ConfigError(f"cannot be written: {error.strerror or error}", file=str(target)) from None
    return target


def _write(content: bytes, folder: Path) -> None:
    with tarfile.open(fileobj=io.BytesIO(content), mode="r:gz") as package:
        for member in package:
            name = member.name.removeprefix("package/")
            if member.isfile() and name.startswith(_PARTS) and ".." not in PurePosixPath(name).parts:
                path, part = folder / name, package.extractfile(member)
                assert part is not None
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(part.read(LIMIT))
