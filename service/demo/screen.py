"""The demonstration on a terminal: a live bar for each calibration, a final table, and every step if verbose."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

WIDTH = 24
NAME = 14


class DemoScreen:
    """Writes to stderr, so that stdout stays for the answer.

    Parameters
    ----------
    quiet
        Say nothing.
    verbose
        Say every prompt, parameter and warning too.
    """

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        self._quiet = quiet
        self._verbose = verbose and not quiet
        self._terminal = sys.stderr.isatty()
        self._name = ""
        self._open = False
        self._asked = ""

    def line(self, text: str = "", *, bold: bool = False) -> None:
        """A line that stays."""
        if not self._quiet:
            self._close()
            fitting = click.wrap_text(text, _columns()) if self._terminal and len(text) > _columns() else text
            click.secho(fitting, err=True, bold=bold)

    def detail(self, text: str) -> None:
        """A line for those who want to see every step."""
        if self._verbose:
            self.line(f"    {text}")

    def begin(self, name: str) -> None:
        """Show the beginning of a calibration."""
        self._name, self._asked = name, ""
        if self._verbose:
            self.line()
            self.line(name, bold=True)
        else:
            self._bar(0.0, "starts")

    def end(self, text: str, *, good: bool) -> None:
        """Show the end of the calibration, with its result."""
        if self._quiet:
            return
        if self._terminal and not self._verbose:
            click.echo("\r" + " " * _columns() + "\r", nl=False, err=True)
            self._open = False
        self._close()
        sign = click.style("ok" if good else "!!", fg="green" if good else "red", bold=True)
        click.echo(f"  {self._name:<{NAME}} {sign}  {text}", err=True)

    def prompt(self, text: str) -> None:
        """Show the present prompt, once even if its details change."""
        if self._verbose and text != self._asked:
            self.line(f"  > {text}", bold=True)
        self._asked = text

    def progress(self, progress: Mapping[str, Any]) -> None:
        """Show the progress of the calibration."""
        target = progress["target"] or 1.0
        self._bar(min(max(progress["current"] / target, 0.0), 1.0), progress["text"])

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Print a table with headings: the first column left-aligned, numbers right-aligned."""
        widths = [max(len(row[i]) for row in [head, *rows]) for i in range(len(head))]
        for at, row in enumerate([head, *rows]):
            cells = [
                f"{row[0]:<{widths[0]}}",
                *(f"{cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True)),
            ]
            self.line("  " + "   ".join(cells), bold=at == 0)

    def _bar(self, share: float, text: str) -> None:
        if self._quiet or not self._terminal:
            return
        bar = "#" * round(share * WIDTH)
        shown = f"  {self._name:<{NAME}} [{bar:<{WIDTH}}] {text}"
        columns = _columns()
        click.echo(f"\r{shown[:columns]:<{columns}}", nl=False, err=True)
        self._open = True

    def _close(self) -> None:
        if self._open:
            click.echo(err=True)
            self._open = False


def _columns() -> int:
    """Usable width of a line: one less than the terminal's, since a full line would wrap."""
    return shutil.get_terminal_size().columns - 1


def called(program: str = sys.argv[0]) -> str:
    """First words of a further command in the shell that started `program`."""
    if Path(program).stem != "mavcal":
        return f"{sys.executable} -m mavcal"
    found = shutil.which("mavcal")
    return "mavcal" if found is not None and Path(found).absolute() == Path(program).absolute() else program
