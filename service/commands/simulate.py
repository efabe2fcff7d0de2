"""``mavcal simulate``: a simulated flight controller on a socket, or a synthetic recording whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.output import json_option, write_json
from mavcal.service.commands.reading import readable_file

if TYPE_CHECKING:
    from mavcal.calib.simulate import Trajectory
    from mavcal.calib.simulate.document import Stated

MOTION_NAMES = (*("rest", "six-faces", "poses", "tumble", "rings", "turntable", "thread", "warm-up", "figure-eight"),)
"""Those of ``calib.simulate.presets.MOTIONS``, stated here so that help does without numpy (a test compares them)."""
_FIELD = (21.0, 1.1, 43.2)  # uT north, east, down: the middle of Europe
_WARM = (20.0, 60.0, 300.0)


@click.group()
def command() -> None:
    """Simulated vehicles, and synthetic recordings."""


class _OfVehicle(click.Command):
    """Takes the options of the simulated vehicle, and lists them as other commands list theirs."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the options of the vehicle, then --help."""
        from mavcal.service import simvehicle

        options = simvehicle.flight_options if self.name == "flight" else simvehicle.options
        own = self.get_help_option(ctx)
        shown = None if own is None else own.get_help_record(ctx)
        with formatter.section("Options"):
            formatter.write_dl([*options(), *([] if shown is None else [shown])])


@command.command(cls=_OfVehicle, options_metavar="[OPTIONS]", context_settings={"ignore_unknown_options": True})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="")
def vehicle(arguments: tuple[str, ...]) -> int:
    """A simulated ArduPilot or PX4 that speaks MAVLink, until it is stopped.

    It prints one line of JSON with its address. Without an address it sends to 127.0.0.1:14550.
    """
    from mavcal.service.simvehicle import run

    return run(arguments)


@command.command(cls=_OfVehicle, options_metavar="[OPTIONS]", context_settings={"ignore_unknown_options": True})
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED, metavar="")
def flight(arguments: tuple[str, ...]) -> int:
    """A simulated ArduCopter that flies and writes a DataFlash log, until it is stopped.

    It prints one line of JSON with its address, and its clock begins when a ground station is heard. It takes the frame
    files and SIM_* parameters of ArduPilot's SITL, as far as they concern the airframe of a quadrotor.
    """
    from mavcal.service.simvehicle import fly

    return fly(arguments)


def _numbers(count: int) -> Callable[[click.Context, click.Parameter, str | None], tuple[float, ...] | None]:
    def parse(_ctx: click.Context, _param: click.Parameter, value: str | None) -> tuple[float, ...] | None:
        if value is None:
            return None
        try:
            numbers = tuple(float(part) for part in value.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != count:
            raise click.BadParameter(f"{value!r} is not {count} numbers with commas between")
        return numbers

    return parse


@command.command()
@click.option("--motion", type=click.Choice(MOTION_NAMES), help="How the sensors move.")
@click.option("--trajectory", "path", help="A recording whose attitude (q_w,q_x,q_y,q_z) they follow instead.")
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Ends in .csv or .npz.")
@click.option("--truth", type=click.Path(path_type=Path, dir_okay=False), help="Write what made it, as JSON.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="The same seed makes the same file."
)
@click.option("--params", help="Sensor errors: .json (ours, or MATLAB's accelparams ...), or .param with SIM_*.")
@click.option(
    "--instance",
    type=click.IntRange(0, 4),
    default=0,
    show_default=True,
    help="Instance of the SIM_* parameters, from 0.",
)
@click.option("--ideal", is_flag=True, help="No errors, except those that --params states.")
@click.option(
    "--frame",
    type=click.Choice(["ned", "enu"]),
    default="ned",
    show_default=True,
    help="Frames of the table and of .json parameters; read enu with --world enu --body flu.",
)
@click.option("--rate", type=float, default=100.0, show_default=True, help="Samples a second.")
@click.option("--mag-rate", type=float, help="Rate of the magnetometer, where it is slower.")
@click.option("--duration", type=float, metavar="S", help="Length of the whole, or of each pose, ring or turn.")
@click.option("--poses", type=click.IntRange(0, 1000), default=10, show_default=True, help="Oblique ones.")
@click.option("--back", is_flag=True, help="Visit six faces or poses again in opposite order.")
@click.option("--fixture-sd", type=float, default=0.0, show_default=True, help="Tilt of each held face, degrees.")
@click.option(
    "--field",
    callback=_numbers(3),
    metavar="UT,UT,UT",
    help="Magnetic field along north,east,down, or east,north,up. [default: 21,1.1,43.2 north,east,down]",
)
@click.option("--gravity", type=float, default=9.80665, show_default=True, help="m/s2.")
@click.option(
    "--temperature",
    callback=_numbers(3),
    metavar="START,END,S",
    help="degC, and the time constant; a warm-up goes from 20 to 60, else 25 throughout.",
)
@click.option("--stream", is_flag=True, help="Truncate to what MAVLink's SCALED_IMU carries.")
@json_option
def recording(
    motion: str | None, path: str | None, out: Path, truth: Path | None, as_json: bool, **options: Any
) -> None:
    """A synthetic recording that `mavcal fit` reads: --motion NAME --out FILE.csv."""
    import numpy as np

    from mavcal.calib.logs.tables import write_table
    from mavcal.calib.simulate import in_frame, simulate
    from mavcal.calib.simulate.document import truth_to_json

    if (motion is None) == (path is None):
        raise click.UsageError("give one of --motion and --trajectory")
    field = _north_east_down(options["field"], options["frame"])
    draw = np.random.default_rng(options["seed"])
    stated = _stated(options, draw)
    suite = stated.suite.streamed() if options["stream"] else stated.suite
    moved = _trajectory(motion, path, options, stated, field, draw)
    made = simulate(moved, suite, draw, mag_rate=options["mag_rate"])
    about = {"motion": motion or Path(str(path)).name, **{k: options[k] for k in ("seed", "gravity")}}
    about["field_ned"] = list(field)
    document = truth_to_json(made, frame=options["frame"], **about, rate=moved.samples_per_second)
    try:
        write_table(in_frame(made.recording, options["frame"]), out)
        if truth is not None:
            truth.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise click.ClickException(f"{error.filename} cannot be written: {error.strerror}") from error
    for name in stated.ignored:
        click.echo(f"{name} has no counterpart here and was left out", err=True)
    if as_json:
        write_json({"out": str(out), "truth": document, "ignored": list(stated.ignored)})
    else:
        click.echo(f"{out}: {len(moved.t)} samples over {moved.t[-1] - moved.t[0]:.0f} s", err=True)


def _stated(options: dict[str, Any], draw: Any) -> Stated:
    """The sensors: those of the file, ideal ones, or a unit drawn by the seed."""
    from mavcal.calib.simulate import SensorSuite
    from mavcal.calib.simulate.document import Stated, stated_in
    from mavcal.calib.simulate.typical import typical

    if options["params"] is None:
        return Stated(SensorSuite() if options["ideal"] else typical(draw))
    file = readable_file(options["params"])
    text = file.read_text(encoding="utf-8", errors="replace")
    return stated_in(text, file.suffix, frame=options["frame"], instance=options["instance"], rate=options["rate"])


def _north_east_down(field: tuple[float, ...] | None, frame: str) -> tuple[float, ...]:
    if field is None:
        return _FIELD
    return field if frame == "ned" else (field[1], field[0], -field[2])


def _trajectory(
    motion: str | None, path: str | None, options: dict[str, Any], stated: Stated, field: tuple[float, ...], draw: Any
) -> Trajectory:
    import numpy as np
    from scipy.spatial.transform import Rotation

    from mavcal.calib.logs.tables import read_table
    from mavcal.calib.recording import Sensor
    from mavcal.calib.simulate import MotionOptions, Warming, along, motion_of, trajectory

    given = options["temperature"] or (_WARM if motion == "warm-up" and stated.warming is None else None)
    warming = stated.warming if given is None else Warming(*given)
    facts: dict[str, Any] = {"field": np.array(field), "gravity": options["gravity"], "warming": warming}
    if path is not None:
        frames: dict[str, Any] = {"world": options["frame"], "body": "frd" if options["frame"] == "ned" else "flu"}
        attitude = read_table(readable_file(path), **frames).channel(Sensor.ATTITUDE)
        return along(attitude.t, Rotation.from_quat(attitude.values, scalar_first=True), **facts)
    assert motion is not None
    made = motion_of(
        motion, MotionOptions(options["duration"], options["poses"], options["fixture_sd"], options["back"]), draw
    )
    return trajectory(made.legs, options["rate"], start=made.start, **facts)
