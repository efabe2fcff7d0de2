"""``mavcal demo``: the main job end to end."""

from __future__ import annotations

import secrets

import click

from mavcal.service.commands.output import EXIT_NO, json_option, write_json


@click.command()
@click.option(
    "--autopilot", type=click.Choice(["ardupilot", "px4"]), default="ardupilot", show_default=True, help="Personality."
)
@click.option("--seed", type=int, default=None, help="Draws the truth of the sensors; printed, random by default.")
@click.option(
    "--speed",
    type=click.FloatRange(1.0, 100.0),
    default=30.0,
    show_default=True,
    help="Vehicle seconds in a second; less on a busy machine.",
)
@click.option("--keep-open", is_flag=True, help="Keep the service and its panel running afterwards.")
@click.option("--verbose", is_flag=True, help="Show every prompt, parameter and warning.")
@json_option
def command(*, autopilot: str, seed: int | None, speed: float, keep_open: bool, verbose: bool, as_json: bool) -> int:
    """Calibrate a simulated vehicle end to end and compare with its truth.

    Exit code 0 only if every parameter is proved on the vehicle and the stated uncertainties are true.
    """
    from mavcal.service.demo.run import DemoError, run
    from mavcal.service.demo.screen import DemoScreen

    drawn = secrets.randbelow(1_000_000) if seed is None else seed
    try:
        screen = DemoScreen(quiet=as_json, verbose=verbose)
        result = run(autopilot, seed=drawn, screen=screen, keep_open=keep_open, speed=speed)
    except DemoError as error:
        click.echo(f"mavcal: {error} (seed {drawn})", err=True)
        if as_json:
            write_json({"ok": False, "reasons": [str(error)], "seed": drawn, "autopilot": autopilot})
        return EXIT_NO
    if as_json:
        write_json(result.document)
    return 0 if result.ok else EXIT_NO
