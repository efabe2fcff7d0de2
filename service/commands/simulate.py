"""``mavcal simulate``: a simulated flight controller on a socket."""

from __future__ import annotations

import click


@click.group()
def command() -> None:
    """Simulated vehicles; synthetic recordings come later."""


@command.command(
    context_settings={"ignore_unknown_options": True, "help_option_names": []},
    add_help_option=False,
)
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
def vehicle(arguments: tuple[str, ...]) -> int:
    """A simulated ArduPilot or PX4 that speaks MAVLink; `mavcal simulate vehicle --help` lists its options."""
    from service.simvehicle.__main__ import main

    return main(arguments)


@command.command()
def recording() -> None:
    """A synthetic recording: comes later."""
    raise click.ClickException("synthetic recordings come later; a simulated vehicle can be recorded now")
