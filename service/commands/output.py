"""Output of commands: one JSON object on stdout with ``--json``, otherwise text; logs and errors on stderr."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from mavcal.client import ApiProblem

EXIT_NO = 1
"""The answer is no: a failed check, a refused fit."""
EXIT_USAGE = 2
"""Wrong use or unreadable input."""
EXIT_PART = 3
"""Done in part: a sensor left out, a partial proof where a full one was asked for, or an undecided check."""

WRONG_USE = frozenset({401, 403, 422, 429})
"""HTTP statuses that mean wrong use; every other problem is the answer no."""


class AnsweredNo(click.ClickException):
    """A running service refused what was asked, or did not answer; `code` says to programs why."""

    def __init__(self, code: str, detail: str, exit_code: int = EXIT_NO) -> None:
        super().__init__(detail)
        self.code, self.ends_with = code, exit_code


def refused(problem: ApiProblem) -> AnsweredNo:
    """The error for a service's refusal."""
    code = EXIT_USAGE if problem.status in WRONG_USE else EXIT_NO
    return AnsweredNo(problem.code or "problem", problem.detail or str(problem), code)


json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")


def wants_json(arguments: Sequence[str]) -> bool:
    """Whether an error must be told as JSON too."""
    return "--json" in arguments


def write_json(document: Mapping[str, Any]) -> None:
    """Print one JSON object; non-finite numbers become null."""
    from mavcal.calib.report import to_json  # brings numpy, which help and versions do without

    click.echo(json.dumps(to_json(document), allow_nan=False))


@contextmanager
def writing(out: Path) -> Iterator[None]:
    """Say that `out` cannot be written if the block fails to. Raises ClickException."""
    try:
        yield
    except OSError as error:
        raise click.ClickException(f"{out} cannot be written: {error.strerror}") from error


def write_file(out: Path, text: str) -> None:
    """Write a text file and say how many lines it has. Raises ClickException if it cannot be written."""
    with writing(out):
        out.write_text(text, encoding="utf-8", newline="\n")
    click.echo(f"{out}: {len(text.splitlines())} lines", err=True)
