"""Options of every live command that choose its vehicles and the service that it asks."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.config import load_settings
from mavcal.service.commands.place import CommandPlace, place_of
from mavcal.service.commands.remote import DEFAULT_URL, Command, key_option

if TYPE_CHECKING:
    from mavcal.service.settings import Settings


data_dir_option = click.option("--data-dir", type=click.Path(path_type=Path), help="Where everything is kept.")
NEITHER = "give --connect URL of a vehicle, or --url URL of a running service"


@dataclass(frozen=True)
class Whom:
    """The vehicles that a command is about, and how they are reached."""

    urls: tuple[str, ...] = ()
    """Endpoints, for the application in this process."""
    every: bool = False
    wait_s: float = 30.0
    ids: tuple[str, ...] = ()
    """Vehicles by id or MAVLink system id; none: the only one, or with `every` all of them."""
    url: str | None = None
    """A running service; None: the application in this process is asked."""
    key_file: Path | None = None
    data_dir: Path | None = None

    @functools.cached_property
    def settings(self) -> Settings:
        """Settings of the application in this process; their own endpoints count only where every vehicle is meant."""
        return load_settings(data_dir=self.data_dir, connect=None if self.every and not self.urls else ())

    @functools.cached_property
    def place(self) -> CommandPlace:
        """Options with which the next command finds the same vehicles."""
        only = self.ids[0] if len(self.ids) == 1 else None
        if self.url is not None:
            return CommandPlace(url=self.url, key_file=self.key_file, vehicle=only)
        return place_of(self.settings, self.urls[0] if len(self.urls) == 1 and not self.every else None)

    def require_sense(self, *, needed: str, alone: bool, of_links: bool) -> None:
        """Raise UsageError where the options contradict each other, or say too little, which `needed` says."""
        if self.url is not None:
            if self.urls:
                raise click.UsageError("--connect and --url exclude each other: give the one or the other")
            if self.data_dir is not None:
                raise click.UsageError("--data-dir goes with --connect: the service of --url has its own, leave it out")
        elif self.ids and not of_links:
            raise click.UsageError("--vehicle chooses among those of a --url: leave it out with --connect")
        elif self.key_file is not None:
            raise click.UsageError("--key-file is the key of a --url: leave it out with --connect")
        elif needed and not (self.urls or self.every):
            raise click.UsageError(needed)
        if self.every and self.ids and not of_links:
            raise click.UsageError("--vehicle chooses one and --all takes every vehicle: give the one or the other")
        if alone and not self.every and max(len(self.urls), len(self.ids)) > 1:
            raise click.UsageError("this is done with one vehicle at a time: give one --connect URL or one --vehicle")


def whom_options(
    *,
    many: bool = False,
    every: bool = False,
    chosen: bool = True,
    campaign: bool = False,
    optional: bool = False,
    wait_s: float = 30.0,
    wait_help: str = "How long to wait for a vehicle, s.",
) -> Callable[[Command], Command]:
    """Add the options by which a command finds its vehicles; it gets them as ``whom``.

    Parameters
    ----------
    many
        Several vehicles can be named.
    every
        There is ``--all``.
    chosen
        There is ``--vehicle``; without, a job says which vehicle of a service is meant.
    campaign
        Every vehicle of the endpoints or of the service is meant; ``--vehicle`` chooses among them.
    optional
        Neither endpoint nor service has to be named.
    wait_s, wait_help
        How long vehicles are waited for if nothing else is said, and the words for it.
    """
    several = many or campaign
    endpoints = "Endpoint of a vehicle, as udpin:0.0.0.0:14550"
    options = [
        click.option("--connect", "urls", multiple=True, metavar="URL",
                     help=f"{endpoints}; several." if several or every else f"{endpoints}."),
        click.option("--url", default=None, metavar="URL",
                     help=f"Ask a running service in place of --connect, as {DEFAULT_URL}."),
        key_option,
        click.option("--vehicle", "ids", multiple=True, metavar="ID",
                     help="Only this vehicle, by its id or system id; repeated." if campaign else
                     "With --url: which vehicle, by its id or system id" + ("; several." if many else ".")),
        click.option("--all", "every", is_flag=True,
                     help="Every vehicle that is heard on each --connect, or of the service. Without either, on the "
                     "links of the settings and of the data directory."),
        data_dir_option,
        click.option("--wait", type=float, default=wait_s, show_default=True, help=wait_help),
    ]  # fmt: skip
    needed = "" if optional else f"{NEITHER}, or --all for every vehicle of the data directory" if every else NEITHER
    left_out = (() if chosen else (3,)) + (() if every else (4,))

    def add(command: Command) -> Command:
        @functools.wraps(command)
        def run(*, wait: float, **given: Any) -> Any:
            own = {name: given.pop(name) for name in ("urls", "url", "key_file", "data_dir")}
            ids = given.pop("ids", ())
            whom = Whom(every=given.pop("every", False), ids=ids, wait_s=wait, **own)
            whom.require_sense(needed=needed, alone=not several, of_links=campaign)
            return command(whom=whom, **given)

        found: Any = run
        for number, option in reversed(list(enumerate(options))):
            found = found if number in left_out else option(found)
        return found  # type: ignore[no-any-return]

    return add
