"""``mavcal gap close``: fly the simulator, diagnose, set what differs, and fly again until nothing is left."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.gap_options import (
    LIMIT_S,
    FiniteRange,
    Line,
    NumberRange,
    layout_option,
    mass_option,
    sim_frame_option,
)
from mavcal.service.commands.output import (
    EXIT_NO,
    EXIT_PART,
    EXIT_USAGE,
    AnsweredNo,
    json_option,
    write_file,
    write_json,
)
from mavcal.service.commands.reading import readable_file, reading_options, split_reading

if TYPE_CHECKING:
    from mavcal.calib.gap.schema import GapReport
    from mavcal.calib.recording import Recording
    from mavcal.service.closing.loop import ClosingPlan, ClosingResult, OnProgress
    from mavcal.service.closing.rounds import RoundResult

CONNECT = "tcp:127.0.0.1:{port}"
MISSIONS = ("standard", "log")
"""Those of ``service.closing.mission.MissionKind``, stated here so that help does without numpy (a test compares)."""
_SAY_EVERY_S = 10.0
"""Where there is no terminal, progress is a line now and then."""
_PAGE = "diagnosis.html"


@click.command()
@click.option("--real", required=True, metavar="FILE", help="The flight that the simulator is to fly like.")
@click.option(
    "--simulator",
    required=True,
    metavar='"CMD {params} {frame} {log} {port} {speedup}"',
    help="The command that starts the simulator, with placeholders for files, MAVLink port and speed; {here} is the "
    "present folder. It runs in the folder of its round. Without {params} parameters are set over MAVLink.",
)
@click.option(
    "--connect",
    default=CONNECT,
    show_default=True,
    metavar="URL",
    help="Where the simulator speaks MAVLink.",
)
@click.option("--rounds", type=click.IntRange(0, 20), default=3, show_default=True, help="Most flights with a remedy.")
@click.option("--speedup", type=FiniteRange(min=0.0), default=4.0, show_default=True, help="What {speedup} stands for.")
@click.option(
    "--mission",
    "kind",
    type=click.Choice(MISSIONS),
    default=MISSIONS[0],
    show_default=True,
    help="What is flown: manoeuvres that show every effect, or the mission that --real holds, moved to the "
    "simulator's home.",
)
@click.option(
    "--params",
    "parameters",
    default=None,
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
    help="Parameters that the simulator flies with from the first round on.",
)
@sim_frame_option
@layout_option
@mass_option
@click.option(
    "--work",
    default=Path("gap-close"),
    show_default=True,
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the rounds; a loop that was interrupted goes on there.",
)
@click.option("--report", "page", type=click.Path(path_type=Path, dir_okay=False), help="Write the rounds as HTML.")
@click.option(
    "--limit-s",
    type=NumberRange(min=0.0, min_open=True),
    default=LIMIT_S,
    show_default=True,
    metavar="SECONDS",
    help="Processor time of each diagnosis; inf: as long as it takes.",
)
@reading_options
@json_option
def command(
    *, page: Path | None, limit_s: float, layout: str | None, mass: float | None, as_json: bool, **options: Any
) -> int:
    """Close the loop: fly the simulator, diagnose --real against it, set what differs, and fly again.

    It ends when nothing material is left, or after --rounds. The standard mission takes about two minutes of the
    simulator's clock. Exit code 0 if nothing material is left, 1 if nothing could be tested, 3 if something is left.
    """
    from mavcal.service.closing.errors import ClosingError
    from mavcal.service.closing.loop import Closing
    from mavcal.service.closing.rounds import Outcome
    from mavcal.service.commands.gap_files import check_folders

    check_folders(() if page is None else (page,))
    with _ended_cleanly(), Line(quiet_s=_SAY_EVERY_S) as line:
        try:
            plan = _plan(options)

            def show_progress(number: int, doing: str, share: float, left_s: float | None) -> None:
                left = "" if left_s is None else f", about {max(round(left_s), 1)} s left"
                line.write(f"round {number}, {doing}: {100 * share:.0f} % done{left}")

            def show_round(result: RoundResult) -> None:
                line.clear()
                if not as_json:
                    _show(result)

            result = Closing(plan, _diagnosis(limit_s, layout, mass), show_progress, show_round).run()
        except ClosingError as error:
            line.clear()
            raise AnsweredNo(error.code, str(error), EXIT_USAGE) from error
    if page is not None:
        from mavcal.service.closing.report import page as page_of

        write_file(page, page_of(result, f"The loop with {Path(options['real']).name}, closed"))
    _answer(result, as_json=as_json)
    return {Outcome.CLOSED: 0, Outcome.NOT_TESTABLE: EXIT_NO}.get(result.outcome, EXIT_PART)


def _plan(options: Mapping[str, Any]) -> ClosingPlan:
    from mavcal.service.closing.loop import ClosingPlan
    from mavcal.service.closing.mission import MissionKind, log_mission, standard_mission
    from mavcal.service.closing.settings import read_settings
    from mavcal.service.closing.simulator import SimulatorCommand
    from mavcal.service.commands.gap_files import read_files, read_frame

    reading, _ = split_reading(dict(options))
    logged = MissionKind(options["kind"]) is MissionKind.LOG
    mission = log_mission(readable_file(options["real"])) if logged else standard_mission()
    command_line = SimulatorCommand(options["simulator"])
    frame = None if options["frame"] is None else read_frame(options["frame"])
    start = read_settings(options["parameters"], frame)
    files = read_files(options["real"], None, (), None, {**reading, "sim_mapping": {}})
    return ClosingPlan(
        real=files.real,
        real_sha256=files.hashes["real"],
        command=command_line,
        work=options["work"],
        here=Path.cwd(),
        start=start,
        rounds=options["rounds"],
        connect=options["connect"],
        speedup=options["speedup"],
        mission=mission,
    )


def _diagnosis(limit_s: float, layout: str | None, mass: float | None) -> Any:
    """The diagnosis of a round, within its time; its page is left in the folder of the round."""
    from mavcal.calib import gap
    from mavcal.calib.gap_report import gap_to_html

    def diagnose(
        real: Recording, sim: Recording, *, frame: Mapping[str, Any], folder: Path, on_progress: OnProgress
    ) -> GapReport:
        began = time.process_time()
        pace = gap.GapPace(
            lambda: time.process_time() - began, limit_s, lambda s: on_progress(s.text, s.share, s.left_s)
        )
        report = gap.run(real, sim, pace=pace, frame=layout, sim_frame=frame, mass=mass)
        (folder / _PAGE).write_text(gap_to_html(report, title=f"Sim-to-real gap, {folder.name}"), encoding="utf-8")
        return report

    return diagnose


@contextmanager
def _ended_cleanly() -> Iterator[None]:
    """SIGTERM ends the loop as Ctrl-C does: with the simulator ended first."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _show(result: RoundResult) -> None:
    from mavcal.service.closing.report import round_lines

    for text in round_lines(result):
        click.echo(text)


def _answer(result: ClosingResult, *, as_json: bool) -> None:
    from mavcal.service.closing.report import sentence

    text = sentence(result)
    if as_json:
        write_json({"outcome": result.outcome.value, "said": text, "rounds": [r.as_json() for r in result.rounds]})
    else:
        click.echo(text)
