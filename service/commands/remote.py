"""Lets commands ask a running service (``--url``) through the typed client, in place of a data directory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from mavcal.service.commands.output import EXIT_USAGE, AnsweredNo, refused

if TYPE_CHECKING:
    from mavcal.client import Client

Command = TypeVar("Command", bound=Callable[..., Any])

DEFAULT_URL = "http://127.0.0.1:8765"

key_option = click.option(
    "--key-file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    default=None,
    help="File with the API key, where the service asks for one.",
)
_url = click.option("--url", default=None, metavar="URL", help=f"Ask the service that runs there, as {DEFAULT_URL}.")
_default_url = click.option("--url", default=DEFAULT_URL, show_default=True, metavar="URL", help="Where it runs.")


def may_be_remote(command: Command) -> Command:
    """Add ``--url`` and ``--key-file`` to a command that can do without a service."""
    return _url(key_option(command))


def remote(command: Command) -> Command:
    """Add ``--url`` and ``--key-file`` to a command that needs a service."""
    return _default_url(key_option(command))


@contextmanager
def service_at(url: str, key_file: Path | None) -> Iterator[Client]:
    """A client of the service at `url`. Raises AnsweredNo for whatever it refuses."""
    from mavcal.client import Client

    with noes(), Client(address(url), key=key_in(key_file)) as client:
        yield client


def address(url: str) -> str:
    """`url`, if a service can be there. Raises UsageError."""
    from urllib.parse import urlsplit

    try:
        parts = urlsplit(url)
        fine = parts.scheme in {"http", "https"} and bool(parts.hostname) and parts.port != 0
    except ValueError:
        fine = False
    if not fine:
        raise click.UsageError(f"--url {url!r} is no address of a service: write it as {DEFAULT_URL}")
    return url


def key_in(file: Path | None) -> str | None:
    """The key of a file. Raises UsageError."""
    if file is None:
        return None
    try:
        key = file.read_text(encoding="ascii").strip()
    except (OSError, ValueError) as error:
        raise click.UsageError(f"--key-file {file} cannot be read: {error}") from None
    if len(key.split()) != 1:
        raise click.UsageError(f"--key-file {file} must hold one key and nothing else")
    return key


@contextmanager
def noes() -> Iterator[None]:
    """Raise AnsweredNo where a service refuses, or cannot answer."""
    from mavcal.client import ApiProblem, UnexpectedAnswer, Unreachable

    try:
        yield
    except ApiProblem as error:
        raise refused(error) from None
    except Unreachable as error:
        raise AnsweredNo("unreachable", f"{error}; is `mavcal serve` running, and is --url its address?") from None
    except UnexpectedAnswer as error:
        raise AnsweredNo("unexpected-answer", str(error), EXIT_USAGE) from None
