"""``mavcal gap``: where a real sensor differs from the simulated one, which effect causes it, how far it shrinks."""

from __future__ import annotations

import textwrap
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.gap_close import command as close
from mavcal.service.commands.gap_options import (
    LIMIT_S,
    Gauge,
    NumberRange,
    layout_option,
    mass_option,
    sim_frame_option,
)
from mavcal.service.commands.gap_selftest import command as selftest
from mavcal.service.commands.output import EXIT_NO, json_option, write_json
from mavcal.service.commands.reading import parse_mapping, reading_options

if TYPE_CHECKING:
    from mavcal.calib.airframe.answer import AirframePart, Rollout
    from mavcal.calib.gap.schema import EffectEstimate, GapReport
    from mavcal.calib.gap.verify import Left, Verified

TARGETS = ("sitl", "frame", "sih", "gazebo", "matlab", "mavcal", "vehicle")
"""Those of ``calib.gap.export.Target``, stated here so that help does without numpy (a test compares them)."""
_MOST_WHERE = 3
_MOST_UNTESTABLE = 8
WIDTH = 80
"""Columns of lines about airframe and air."""


@click.group(invoke_without_command=True)
@click.option("--real", default=None, metavar="FILE", help="The recording whose gap is asked for.  [required]")
@click.option(
    "--sim", default=None, metavar="FILE", help="A simulator's recording: of the same trajectory, or of such a flight."
)
@click.option(
    "--nominal",
    multiple=True,
    metavar="FILE",
    help="A recording without an effect, for noise, field and errors of a pose; repeated.",
)
@click.option(
    "--verify",
    "again",
    default=None,
    metavar="FILE",
    help="A recording of the simulator with the remedy: how much of the gap is left.",
)
@click.option("--report", "page", type=click.Path(path_type=Path, dir_okay=False), help="Write the report as HTML.")
@click.option(
    "--export",
    "exports",
    multiple=True,
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the remedy: .parm .param (ArduPilot's SIM_*), .params (PX4's SIH_*), .sdf (Gazebo), .m (MATLAB), .json "
    "(mavcal simulate; with --for sitl the frame of ArduPilot's simulator); repeated.",
)
@click.option(
    "--for",
    "target",
    type=click.Choice(TARGETS),
    default=None,
    help="Whom --export is for, whatever its ending; vehicle: the vehicle's own calibration.",
)
@sim_frame_option
@layout_option
@mass_option
@click.option(
    "--instance", type=click.IntRange(1, 9), default=1, show_default=True, help="For exports of a single instance."
)
@click.option(
    "--sim-map",
    "sim_mapping",
    callback=parse_mapping,
    metavar="NAME=COLUMN[*FACTOR],...",
    help="--map of --sim and --verify, where their tables have other columns than the real one.",
)
@click.option(
    "--limit-s",
    type=NumberRange(min=0.0, min_open=True),
    default=LIMIT_S,
    show_default=True,
    metavar="SECONDS",
    help="End after so much processor time with the best answer so far; the report says what was left out. "
    "inf: as long as it takes.",
)
@reading_options
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    *,
    real: str | None,
    sim: str | None,
    nominal: tuple[str, ...],
    again: str | None,
    page: Path | None,
    exports: tuple[Path, ...],
    target: str | None,
    frame: str | None,
    layout: str | None,
    mass: float | None,
    instance: int,
    limit_s: float,
    as_json: bool,
    **reading: Any,
) -> int:
    """Diagnose the sim-to-real gap of a recording or a log.

    The reference is found in the files: ref_* columns, a simulator's log of the same trajectory, a pose, other
    instances of the vehicle, or a trajectory that is estimated again. The reading options are of --real, and of the
    other files as far as they are tables. Exit code 1 if nothing could be tested, or not within --limit-s.
    """
    if ctx.invoked_subcommand is not None:
        return 0
    if real is None:
        raise click.UsageError("Missing option '--real'.", ctx)
    from mavcal.calib import gap
    from mavcal.calib.gap.schema import as_json as document_of
    from mavcal.service.commands.gap_files import (
        Remedy,
        check_exports,
        check_folders,
        read_files,
        read_frame,
        write_exports,
        write_page,
    )

    began = time.process_time()
    check_exports(exports, target)
    remedy = Remedy(target, instance, mass, None if frame is None else read_frame(frame))
    check_folders((*exports, *(() if page is None else (page,))))
    files = read_files(real, sim, nominal, again, reading)
    with Gauge() as gauge:
        pace = gap.GapPace(lambda: time.process_time() - began, limit_s, gauge.show)
        report = gap.run(
            files.real,
            files.sim,
            files.nominal,
            inputs=files.hashes,
            pace=pace,
            frame=layout,
            sim_frame=remedy.frame,
            mass=mass,
        )
    document = document_of(report)
    verified = None
    if files.again is not None:
        from mavcal.calib.gap.verify import verified_json, verify

        verified = verify(report, files.real, files.sim, files.again, files.nominal)
        document["verify"] = verified_json(verified)
    if page is not None:
        write_page(report, f"Sim-to-real gap of {Path(real).name}", page)
    if exports:
        document["exports"] = write_exports(report, files, exports, remedy)
    if as_json:
        write_json(document)
    else:
        _show(report, verified)
    return 0 if document["tested"] else EXIT_NO


def _show(report: GapReport, verified: Verified | None) -> None:
    from mavcal.calib.airframe.answer import Domain
    from mavcal.calib.gap_report.airframe_words import effects_of
    from mavcal.calib.gap_report.words import closed_sentence, not_compared, regime, verdict_sentence

    click.echo(f"{report.verdict.value}: {verdict_sentence(report, listed=False)}")
    if missing := not_compared(report):
        click.echo(missing)
    _show_effects(report)
    if report.unknown.flag:
        click.echo(f"not explained: {report.unknown.shape or 'a rest'} ({100 * report.unknown.share:.0f} % of the gap)")
    for found in report.where[:_MOST_WHERE]:
        click.echo(
            f"where: {found.channel} of instance {found.instance}, {regime(found)}: rms {found.rms:.3g} {found.unit}, "
            f"{found.nats_per_sample:.3g} nats a sample"
        )
    if effects_of(report, Domain.SENSOR):
        click.echo(closed_sentence(report.shrink))
    if report.airframe is not None:
        for line in flight_lines(report.airframe):
            click.echo(line)
    if verified is not None:
        _show_verified(verified)
    for gone in report.not_testable[:_MOST_UNTESTABLE]:
        click.echo(f"not testable: {gone.id}: {gone.reason}; needed: {gone.need}")
    if len(report.not_testable) > _MOST_UNTESTABLE:
        click.echo(f"not testable: {len(report.not_testable) - _MOST_UNTESTABLE} more, see --json")
    click.echo(f"reference: {report.inputs.reference_kind}. {report.inputs.reference_text}")
    for warning in report.warnings:
        click.echo(f"! {warning}")


def _show_effects(report: GapReport) -> None:
    """Print effects of airframe and air, each under a heading; also those of sensors if there are others."""
    from mavcal.calib.airframe.answer import Domain
    from mavcal.calib.gap_report.airframe_words import groups

    grouped = report.airframe is not None or any(effect.domain is not Domain.SENSOR for effect in report.effects)
    for heading, effects in groups(report):
        if grouped:
            click.echo(f"{heading}:")
        for effect in effects:
            if effect.domain is Domain.SENSOR:
                _show_effect(effect, "  " if grouped else "")
            else:
                click.echo("\n".join(effect_lines(effect)))


def _show_effect(effect: Any, indent: str) -> None:
    from mavcal.calib.gap_report.words import chance, effect_phrase, with_error

    click.echo(f"{indent}{effect_phrase(effect)}, probability {chance(effect.evidence.probability)}")
    for parameter in effect.params:
        click.echo(f"{indent}  {parameter.name:16} {with_error(parameter.value, parameter.se, parameter.unit)}")
    for rival in effect.confusable_with:
        click.echo(f"{indent}  could be {rival.id}; told apart by: {rival.fix}")


def _show_verified(verified: Verified) -> None:
    from mavcal.calib.gap_report.words import NATS, number

    low, high = verified.remaining.ci95
    click.echo(
        f"with the remedy: {number(verified.remaining.nats)} nats a number are left ({number(low)} to {number(high)}), "
        f"of {number(verified.before.nats)}; {verified.rest.verdict.value}"
    )
    for left in verified.effects:
        if left.remainders:
            click.echo("\n".join(remainder_lines(left)))
            continue
        on = ", ".join(map(str, left.instances))
        same = "; the new flight has it within its errors" if left.agrees else ""
        click.echo(f"  {left.id} of instance {on}: {100 * left.share:.2g} % of its evidence is left{same}")
    if not verified.added:
        click.echo("  the remedy brought nothing in that the vehicle does not have")
    for effect in verified.added:
        click.echo(f"  {effect.id} is in the simulator and not in the vehicle, or was hidden before")
    click.echo(NATS.replace("a sample", "a number"))
    for warning in verified.warnings:
        click.echo(f"! {warning}")


command.add_command(close, "close")
command.add_command(selftest, "selftest")


def effect_lines(effect: EffectEstimate) -> list[str]:
    """Lines on an effect of airframe or air: the finding, its certainty, its numbers, and its rivals."""
    from mavcal.calib.gap_report.airframe_effects import claims, rival_phrase
    from mavcal.calib.gap_report.words import chance, effect_phrase, held_out

    phrase = effect_phrase(effect)
    lines = wrapped(f"{phrase[0].upper()}{phrase[1:]}")
    likelier = ", something else is likelier" if effect.evidence.doubtful else ""
    sure = f"{effect.id}, probability {chance(effect.evidence.probability)}{likelier}; {held_out(effect)}"
    lines += wrapped(sure, "    ")
    for claim in claims(effect):
        text = f"{claim.label}: {claim.difference}" + (f" ({claim.interval})" if claim.interval else "")
        lines += wrapped(f"{text}; {claim.sides}" if claim.sides else text, "    ")
    for rival in effect.confusable_with:
        lines += wrapped(f"could also be {rival_phrase(rival)}", "    ")
    return lines


def remainder_lines(left: Left) -> Iterator[str]:
    """Lines on the rest of an effect of the airframe, parameter by parameter."""
    from mavcal.calib.gap_report.words import number

    motor = "" if not left.instances else f" of motor {', '.join(map(str, left.instances))}"
    for name, one in left.remainders.items():
        nothing, what = (1.0, "real by new") if one.ratio else (0.0, "real less new")
        within = f"within two standard errors of {nothing:g}" if one.within else "not closed"
        unseen = "; the new flight does not show the effect" if left.again is None else ""
        text = f"{left.id}{motor}: {name}, {what} {nothing + one.value:.4g} ± {number(one.se)}, {within}{unseen}"
        yield from wrapped(text)


def flight_lines(part: AirframePart) -> Iterator[str]:
    """Lines on the gain in prediction, the next flight, and the source of frame and commands."""
    from mavcal.calib.gap_report.airframe_words import commands_sentence, geometry_sentence

    if part.rollout:
        yield from _table(part.rollout)
    if part.manoeuvres:
        yield "To decide between what is left, fly:"
        for manoeuvre in part.manoeuvres:
            yield from wrapped(manoeuvre)
    if part.geometry is not None:
        yield from wrapped(geometry_sentence(part.geometry), "")
    if part.commands is not None:
        yield from wrapped(commands_sentence(part.commands), "")


def _table(rollouts: Iterable[Rollout]) -> Iterator[str]:
    """The error of the predicted flight: a row for each horizon."""
    from mavcal.calib.gap_report.airframe_words import closed_words, part_name, quantity_name, sized

    yield "Predicted flight, on data that were held out:"
    yield f"  {'error':28}{'before':>8}{'after':>8}{'floor':>8}"
    for one in rollouts:
        name = f"{quantity_name(one)}, {one.unit}"
        numbers = "".join(f"{sized(one, error):>8}" for error in (one.before, one.after, one.floor))
        yield f"  {name:28}{numbers}  {', '.join(filter(None, (closed_words(one), part_name(one))))}".rstrip()


def wrapped(text: str, indent: str = "  ") -> list[str]:
    """A text in lines, the further ones indented by two more columns; words are not broken."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=f"{indent}  ", break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
