"""Signed deployments: a robot with trusted keys runs only what they signed recently for this robot.

Keys are Ed25519 (RFC 8032), kept as PEM files. What is signed is everything that an envelope says but the text of the
model, which its hash stands for. It holds for `FRESH` seconds and for one run of an engine, so that one that has just
started cannot be given what was recorded before; while it runs, its envelopes are kept in order by their sequence.
"""

from __future__ import annotations

import base64
import json
import os
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from fame.dataclasses import dataclass, replace
from fame.deploy import fields
from fame.errors import ConfigError, DeploymentError
from fame.imports import require
from fame.text import open_file

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

_Message = TypeVar("_Message")
PUBLIC_MODE = 0o644
"""The mode of a file that others may read, but not write, whatever the umask is."""

ANOTHER_RUN = "signed for another run of this robot's engine: it may be a replay"
FRESH = 300.0
"""How old a signature may be (s)."""


def new_keys(stem: Path) -> tuple[Path, Path]:
    """Make a pair of keys: `stem`.key, which is secret, and `stem`.pub. Raises ConfigError if one is there already."""
    ed25519, serialization = _cryptography()
    private = ed25519.Ed25519PrivateKey.generate()
    secret, public = stem.with_name(stem.name + ".key"), stem.with_name(stem.name + ".pub")
    for path in (secret, public):
        if os.path.lexists(path):  # a link that leads nowhere, too
            raise _exists(path)
    encoding, none = serialization.Encoding.PEM, serialization.NoEncryption()
    _create(secret, private.private_bytes(encoding, serialization.PrivateFormat.PKCS8, none), 0o600)
    _create(public, _public_pem(private), PUBLIC_MODE)
    return secret, public


def _create(path: Path, content: bytes, mode: int) -> None:
    """Write a file that is not there yet, not through a link either. Raises ConfigError."""
    try:
        with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode), "wb") as file:
            file.write(content)
    except FileExistsError:
        raise _exists(path) from None


def _exists(path: Path) -> ConfigError:
    return ConfigError("exists already; a key is never overwritten", file=str(path))


def new_run_key(public: Path) -> Ed25519PrivateKey:
    """Make a secret key that stays in this process; the public key goes to a file, for `read_trusted` of others."""
    ed25519, _ = _cryptography()
    return write_public(ed25519.Ed25519PrivateKey.generate(), public)


def read_private(path: Path) -> Ed25519PrivateKey:
    """Return the secret key of a file. Raises ConfigError."""
    ed25519, serialization = _cryptography()

    def loaded(data: bytes) -> Any:
        if b"-----BEGIN PUBLIC KEY-----" in data and b"PRIVATE KEY-----" not in data:
            text = "is the public key, which others may have; expected the private one (NAME.key)"
            raise ConfigError(text, file=str(path))
        return serialization.load_pem_private_key(data, None)

    key = _read(path, loaded)
    if os.name == "posix" and stat.S_IMODE(path.stat().st_mode) & 0o077:
        raise ConfigError(
            f"others can read it, or write it: chmod 600 {path.name}, if it is still a secret", file=str(path)
        )
    if not isinstance(key, ed25519.Ed25519PrivateKey):
        raise ConfigError("is not an Ed25519 private key; make one with: fame keys new NAME", file=str(path))
    return key  # type: ignore[no-any-return]


def read_trusted(paths: Sequence[Path]) -> list[Ed25519PublicKey]:
    """Return the public keys of some files, each of one or many, with anything between them. Raises ConfigError."""
    ed25519, serialization = _cryptography()
    keys = []
    for path in paths:
        for key in _read(path, lambda data: [serialization.load_pem_public_key(block) for block in _blocks(data)]):
            if not isinstance(key, ed25519.Ed25519PublicKey):
                raise ConfigError("is not an Ed25519 public key (NAME.pub)", file=str(path))
            keys.append(key)
    return keys


@dataclass(frozen=True, slots=True)
class Identity:
    """The key with which an engine signs what it says; `voucher`: of a trusted key, for the name of its robot."""

    private: Ed25519PrivateKey
    voucher: str = ""

    @classmethod
    def new(cls) -> Identity:
        """Make an identity without a certificate."""
        return cls(_cryptography()[0].Ed25519PrivateKey.generate())

    @property
    def key(self) -> str:
        """The public key as text."""
        _, serialization = _cryptography()
        raw = serialization.Encoding.Raw, serialization.PublicFormat.Raw  # Debian 12's cryptography has no shorter way
        return base64.b64encode(self.private.public_key().public_bytes(*raw)).decode()


def new_identity(robot: str, team: Ed25519PrivateKey, path: Path) -> None:
    """Make an identity for a robot's engine, for which the key of the team vouches. Raises ConfigError."""
    _, serialization = _cryptography()
    new = Identity.new()
    encoding, none = serialization.Encoding.PEM, serialization.NoEncryption()
    secret = new.private.private_bytes(encoding, serialization.PrivateFormat.PKCS8, none)
    _create(path, f"# {robot} {sign(_name_of(robot, new.key), team)}\n".encode() + secret, 0o600)


def read_identity(path: Path, robot: str) -> Identity:
    """Return the identity of a robot's engine. Raises ConfigError, also for one of another robot."""
    private = read_private(path)
    words = path.read_text(errors="replace").partition("\n")[0].split()
    if len(words) != 3 or words[0] != "#":
        raise ConfigError("is not an identity; make one with: fame keys robot NAME --key TEAM.key", file=str(path))
    if words[1] != robot:
        raise ConfigError(f"is the identity of robot {words[1]!r}, not of {robot!r}", file=str(path))
    return Identity(private, words[2])


def is_vouched(robot: str, key: str, voucher: str, trusted: Sequence[Ed25519PublicKey]) -> bool:
    """Return whether a trusted key has signed that a public key (as text) is that of a robot."""
    try:
        verify_signature({**_name_of(robot, key), "signature": voucher}, trusted)
    except DeploymentError:
        return False
    return True


def is_signed(content: Mapping[str, Any], key: str) -> bool:
    """Return whether the owner of a public key (as text) signed it."""
    try:
        verify_signature(content, [_public(key)])
    except (ValueError, DeploymentError):
        return False
    return True


@lru_cache(maxsize=1000)
def _public(key: str) -> Ed25519PublicKey:
    """A public key of a text. Raises ValueError."""
    data = base64.b64decode(key, validate=True)
    public: Ed25519PublicKey = _cryptography()[0].Ed25519PublicKey.from_public_bytes(data)
    return public


def _name_of(robot: str, key: str) -> dict[str, str]:
    return {"robot": robot, "key": key}


def with_signature(message: _Message, key: Ed25519PrivateKey, **changes: Any) -> _Message:
    """Return a message, a dataclass of `fields`, with changed fields and the signature of all."""
    changed: Any = replace(message, **changes)  # type: ignore[type-var]
    signed: _Message = replace(changed, signature=sign(fields.values(changed), key))
    return signed


def sign(content: Mapping[str, Any], key: Ed25519PrivateKey) -> str:
    """Return the signature of what an envelope says, as base64."""
    return base64.b64encode(_signature(key, _signed_part(content))).decode()


def verify_signature(content: Mapping[str, Any], trusted: Sequence[Ed25519PublicKey]) -> None:
    """Raise DeploymentError unless a trusted key signed it, whenever that was."""
    signature = content.get("signature", "")
    if not signature:
        raise DeploymentError(
            "not signed; this robot runs only deployments signed with a trusted key (of a team of fame run: its --key)",
            cause="signature",
        )
    try:
        blob = base64.b64decode(signature, validate=True)
    except ValueError:
        raise DeploymentError("the signature is not base64", cause="signature") from None
    part = _signed_part(content)
    if any(_has_signed(key, blob, part) for key in trusted):
        return
    raise DeploymentError(
        "not signed by a key that this robot trusts (a team of fame run trusts its --key)", cause="signature"
    )


def _signature(key: Ed25519PrivateKey, part: bytes) -> bytes:
    return key.sign(part)


def _has_signed(key: Ed25519PublicKey, signature: bytes, part: bytes) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        key.verify(signature, part)
    except InvalidSignature:
        return False
    return True


def signer(content: Mapping[str, Any], trusted: Sequence[Ed25519PublicKey]) -> str:
    """Return the fingerprint of the trusted key that signed it; empty if none did."""
    _, serialization = _cryptography()
    raw = serialization.Encoding.Raw, serialization.PublicFormat.Raw
    for key in trusted:
        with suppress(DeploymentError):
            verify_signature(content, [key])
            return f"key {sha256(key.public_bytes(*raw)).hexdigest()[:16]}"
    return ""


def verify(content: Mapping[str, Any], trusted: Sequence[Ed25519PublicKey], now: float, born: int = 0) -> None:
    """Raise DeploymentError unless a trusted key signed it, not long ago, for the engine that was `born` then (ns).

    `now` in s since 1970.
    """
    verify_signature(content, trusted)
    age = now - float(content.get("issued", 0.0))
    if not abs(age) <= FRESH:
        text = f"signed {age:.0f} s ago; at most {FRESH:g} s are accepted (are the clocks set?)"
        raise DeploymentError(text, cause="clock")
    if content.get("born", 0) != born:
        raise DeploymentError(ANOTHER_RUN, cause="replay")


def write_public(private: Ed25519PrivateKey, path: Path) -> Ed25519PrivateKey:
    """Write the public key of a secret key, which is returned, to a file."""
    with open(path, "wb", opener=lambda name, flags: os.open(name, flags, PUBLIC_MODE)) as file:
        file.write(_public_pem(private))
    return private


def _public_pem(private: Ed25519PrivateKey) -> bytes:
    _, serialization = _cryptography()
    info = serialization.PublicFormat.SubjectPublicKeyInfo
    return private.public_key().public_bytes(serialization.Encoding.PEM, info)


def _signed_part(content: Mapping[str, Any]) -> bytes:
    recalled = ("promises", "receivers") if content.get("recalls") else ()  # a robot adds them; `recalls` is their hash
    kept = {name: value for name, value in content.items() if name not in ("model", "signature", *recalled)}
    return json.dumps(kept, sort_keys=True, separators=(",", ":")).encode()


def _blocks(data: bytes) -> list[bytes]:
    """The PEM blocks of a file; what is broken is for the loader to complain about."""
    begin = b"-----BEGIN "
    return [begin + block for block in data.split(begin)[1:]] or [data]


def _read(path: Path, load: Any) -> Any:
    from cryptography.exceptions import UnsupportedAlgorithm

    try:
        with open_file(path) as stream:
            return load(stream.read())
    except OSError as error:
        raise ConfigError(f"cannot be read: {error.strerror}", file=str(path)) from None
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise ConfigError(f"is not a key in PEM: {error}", file=str(path)) from None


@cache
def _cryptography() -> tuple[Any, Any]:
    require("cryptography")
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ed25519

    return ed25519, serialization
