"""Prompts and progress on a terminal; plain lines where there is none."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

import click

from mavcal.service.commands.place import NO_OPTIONS, CommandPlace

BAR = 28
SAY_EVERY_S = 10.0
"""Longest time between two lines of progress where there is no terminal."""


class Screen:
    """Writes to stderr, so that stdout stays for the answer. On a terminal one line is redrawn.

    A command that a line names is told with the options of `place`, so that it can be run as it stands.
    """

    def __init__(
        self, place: CommandPlace = NO_OPTIONS, *, quiet: bool = False, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.place = place
        self._quiet, self._clock = quiet, clock
        self._shown_at = -math.inf
        self._terminal = sys.stderr.isatty()
        self._open = False
        self._shown: tuple[object, ...] = ()
        self._asked = ""

    def line(self, text: str = "", *, bold: bool = False) -> None:
        """Print a line that stays."""
        if self._quiet:
            return
        self._close()
        self._shown_at = self._clock()
        click.secho(self.place.completed(text), err=True, bold=bold)

    def prompt(self, text: str) -> None:
        """Print an instruction to the operator once, although its details may change."""
        if text == self._asked:
            return
        self._asked = text
        self.line(f"  > {text}", bold=True)

    def progress(self, progress: Mapping[str, Any]) -> None:
        """A bar; without a terminal, a line at every quarter, and when nothing was said for ten seconds."""
        if self._quiet:
            return
        target = progress["target"] or 1.0
        share = min(max(progress["current"] / target, 0.0), 1.0)
        eta = "" if progress["eta"] is None else f"  {progress['eta']:.0f} s left"
        if not self._terminal:
            key = (int(share * 4), progress["unit"])
            if key != self._shown or self._clock() - self._shown_at >= SAY_EVERY_S:
                self._shown, self._shown_at = key, self._clock()
                click.echo(f"    {share:4.0%}  {progress['text']}", err=True)
            return
        bar = "#" * round(share * BAR)
        text = f"    [{bar:<{BAR}}] {share:4.0%}  {progress['text']}{eta}"
        click.echo(f"\r{text[:118]:<118}", nl=False, err=True)
        self._open = True

    def _close(self) -> None:
        if self._open:
            click.echo(err=True)
            self._open = False
