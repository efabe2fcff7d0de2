"""Named keys that sign links: from the settings, and from a file in the data directory that only its owner may read."""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mavcal.service.errors import SigningKeyError, SigningKeyUnknown
from mavcal.service.settings import SIGNING_KEY, MavlinkSettings

FILE = "signing-keys.json"
DEFAULT = "default"
"""Name of `mavlink.signing_key`, which signs every link that names no key."""
UNSIGNED = "none"
"""Name in a link that stays unsigned although there is a default key."""
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_KEY_BYTES = 32


@dataclass(frozen=True)
class KnownKey:
    """A signing key without the key."""

    name: str
    fingerprint: str
    """The first 12 digits of the SHA-256 of the key's 32 bytes."""
    source: Literal["settings", "file"]
    """Where it is kept."""


class SigningKeys:
    """Keys by name. The file is read at every look, so that what another process adds is there at once."""

    def __init__(self, data_dir: Path, settings: MavlinkSettings) -> None:
        self._path = data_dir / FILE
        fixed = {name: key.get_secret_value() for name, key in settings.signing_keys.items()}
        if settings.signing_key is not None:
            fixed[DEFAULT] = settings.signing_key.get_secret_value()
        self._fixed: Mapping[str, str] = fixed

    def all(self) -> tuple[KnownKey, ...]:
        """Every key, by name. Raises SigningKeyError if the file cannot be used."""
        kept = self._kept()
        known = [KnownKey(name, fingerprint(key), "file") for name, key in kept.items() if name not in self._fixed]
        known += [KnownKey(name, fingerprint(key), "settings") for name, key in self._fixed.items()]
        return tuple(sorted(known, key=lambda key: key.name))

    def named(self, name: str | None) -> tuple[str, bytes] | None:
        """Name and bytes of the key of a link; None: the link is not signed. `name` None: the link names no key.

        Raises
        ------
        SigningKeyUnknown
            If there is no key of that name: the link must not be opened unsigned instead.
        """
        if name == UNSIGNED or (name is None and DEFAULT not in self._fixed):
            return None
        name = DEFAULT if name is None else name
        text = self._fixed.get(name) or self._kept().get(name)
        if text is None:
            known = ", ".join(key.name for key in self.all()) or "none"
            raise SigningKeyUnknown(
                f"there is no signing key {name!r}; known: {known}. `mavcal config signing add {name}` adds it"
            )
        return name, bytes.fromhex(text)

    def add(self, name: str, key: str | None = None) -> tuple[KnownKey, str]:
        """Keep a key of 64 hexadecimal digits, None: a new one of the system's random source; it, and its digits.

        Raises
        ------
        SigningKeyError
            If the name is taken or no name, the key is no key, or the file cannot be written.
        """
        if not NAME.fullmatch(name) or name in (DEFAULT, UNSIGNED):
            raise SigningKeyError(
                f"{name!r} cannot name a signing key: give 1 to 64 letters, digits, '.', '_' or '-', but neither "
                f"{DEFAULT!r} nor {UNSIGNED!r}"
            )
        digits = secrets.token_hex(_KEY_BYTES) if key is None else key.strip().lower()
        if not re.fullmatch(SIGNING_KEY, digits):
            raise SigningKeyError("a signing key has 64 hexadecimal digits")
        kept = self._kept()
        if name in kept or name in self._fixed:
            raise SigningKeyError(f"there is a signing key {name!r} already: remove it first, or choose another name")
        self._write({**kept, name: digits})
        return KnownKey(name, fingerprint(digits), "file"), digits

    def remove(self, name: str) -> KnownKey:
        """Forget a key of the file.

        Raises
        ------
        SigningKeyUnknown
            If there is none of that name.
        SigningKeyError
            If the settings hold it, or the file cannot be written.
        """
        if name in self._fixed:
            raise SigningKeyError(f"the signing key {name!r} stands in the settings: remove it there")
        kept = self._kept()
        if name not in kept:
            raise SigningKeyUnknown(f"there is no signing key {name!r}")
        gone = kept.pop(name)
        self._write(kept)
        return KnownKey(name, fingerprint(gone), "file")

    def _kept(self) -> dict[str, str]:
        try:
            with self._path.open(encoding="utf-8") as file:
                mode = os.fstat(file.fileno()).st_mode & 0o777
                text = file.read()
        except FileNotFoundError:
            return {}
        except (OSError, UnicodeDecodeError) as error:
            raise SigningKeyError(f"{self._path} cannot be read ({error})") from error
        if mode & 0o077:
            raise SigningKeyError(f"{self._path} has mode {mode:04o}, so others can read it: chmod 600 {self._path}")
        try:
            keys = json.loads(text)["keys"]
            sound = all(NAME.fullmatch(name) and re.fullmatch(SIGNING_KEY, key) for name, key in keys.items())
        except (ValueError, LookupError, TypeError, AttributeError):
            sound = False
        if not sound:
            raise SigningKeyError(f"{self._path} is damaged: put it back from a backup, or remove it and add the keys")
        return dict(keys)

    def _write(self, keys: Mapping[str, str]) -> None:
        """Replace the file atomically; it is never readable by others, not even while it is written."""
        beside = self._path.with_suffix(".new")
        try:
            with suppress(FileNotFoundError):
                beside.unlink()
            descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                json.dump({"keys": dict(sorted(keys.items()))}, file, indent=1)
                file.flush()
                os.fsync(file.fileno())
                if os.geteuid() == 0:  # added by root, read by the service's own user
                    owner = self._path.parent.stat()
                    os.fchown(file.fileno(), owner.st_uid, owner.st_gid)
            beside.replace(self._path)
        except OSError as error:
            raise SigningKeyError(f"{self._path} cannot be written ({error.strerror or error})") from error


def fingerprint(digits: str) -> str:
    """Fingerprint of a key: the first 12 digits of the SHA-256 of its bytes."""
    return hashlib.sha256(bytes.fromhex(digits)).hexdigest()[:12]
