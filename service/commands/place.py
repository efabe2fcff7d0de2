"""Options that a command was run with: the next command that a sentence names needs them too."""

from __future__ import annotations

import importlib
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from mavcal.service.settings import Settings

_NAMED = re.compile(r"`mavcal ([a-z][^`]*)`")


@dataclass(frozen=True)
class CommandPlace:
    """The options of a command that the next commands need; None: not given."""

    connect: str | None = None
    data_dir: Path | None = None
    url: str | None = None
    key_file: Path | None = None
    vehicle: str | None = None

    def completed(self, text: str) -> str:
        """`text` with these options added to every command in it that accepts them but lacks them."""
        return _NAMED.sub(lambda named: f"`mavcal {self._with_options(named[1])}`", text)

    def _with_options(self, words: str) -> str:
        given = words.split()
        taken = _flags(given)
        if self.url is not None and "--url" in taken:
            values: dict[str, object] = {"--url": self.url, "--key-file": self.key_file, "--vehicle": self.vehicle}
        elif self.url is not None:
            values = {}  # what a service keeps is in no data directory of this machine
        else:
            values = {"--connect": self.connect, "--data-dir": self.data_dir}
        if "--all" in given:
            values = {flag: v for flag, v in values.items() if flag not in {"--connect", "--vehicle"}}
        more = [f"{flag} {shlex.quote(str(v))}" for flag, v in values.items() if v is not None and flag in taken]
        return " ".join([words, *(text for text in more if text.split()[0] not in given)])


NO_OPTIONS = CommandPlace()


def place_of(settings: Settings, connect: str | None = None) -> CommandPlace:
    """The place of a run with these settings on this endpoint; the default data directory needs no naming."""
    from mavcal.service.settings import default_data_dir

    kept = settings.data_dir
    own = None if kept == default_data_dir().absolute() else kept
    return CommandPlace(connect or (settings.connect[0] if settings.connect else None), own)


def _flags(words: Sequence[str]) -> frozenset[str]:
    """The options that the command named by the first of `words` takes; none if there is no such command."""
    try:
        command = importlib.import_module(f"mavcal.service.commands.{words[0]}").command
    except ModuleNotFoundError:
        return frozenset()
    for word in words[1:]:
        if not isinstance(command, click.Group) or word not in command.commands:
            break
        command = command.commands[word]
    return frozenset(flag for parameter in command.params for flag in parameter.opts)
