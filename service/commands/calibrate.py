"""``mavcal calibrate``: one calibration without a panel, by the same jobs as the service."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from service.commands.config import load_settings
from service.commands.output import EXIT_NO, json_option, write_json
from service.commands.plan_options import given, plan_options

if TYPE_CHECKING:
    from calib.firmware.plan import WritePlan
    from service.commands.headless import Earlier
    from service.commands.screen import Screen
    from service.core import Service
    from service.jobs.model import Job
    from service.jobs.recovery import Unfinished
    from service.vehicle import Vehicle

PATIENCE_S = 10.0
"""How long a write waits for the vehicle to be writable."""

KINDS = (
    *("gyro", "accel", "mag", "thermal", "level"),
    *("accel-one-axis", "accel-six-face", "mag-rings", "gyro-turntable", "gyro-thread", "imu-multi"),
)
"""Those of ``calib.procedures.registry``, stated here so that help does without numpy (a test compares them)."""


@click.command()
@click.argument("kind", type=click.Choice(KINDS))
@click.option("--connect", required=True, metavar="URL", help="Endpoint of the vehicle, as udpin:0.0.0.0:14550.")
@click.option("--apply", "write", is_flag=True, help="Write the result to the vehicle and prove it.")
@click.option("--require-proof", is_flag=True, help="With --apply: exit code 1 unless the streams prove all of it.")
@click.option("--reboot", is_flag=True, help="With --apply: restart the vehicle if the plan needs it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the procedure.")
@plan_options
@click.option("--data-dir", type=click.Path(path_type=Path), default=None, help="Where everything is kept.")
@click.option("--wait", type=float, default=30.0, show_default=True, help="How long to wait for a vehicle, s.")
@json_option
def command(
    kind: str,
    connect: str,
    write: bool,
    require_proof: bool,
    reboot: bool,
    options: tuple[str, ...],
    data_dir: Path | None,
    wait: float,
    as_json: bool,
    **more: Any,
) -> int:
    """Calibrate one sensor of a vehicle, headless; nothing is written without --apply.

    What an interrupted run left on this vehicle is finished or taken back first. A line typed while it runs answers
    the present prompt (`finish`, or the number that it asks for). Exit code 1 if the calibration did not succeed; with
    --require-proof also if the streams do not prove everything that shows there.
    """
    from service.commands.screen import Screen
    from service.logs import configure_logging

    if require_proof and not write:
        raise click.UsageError("--require-proof asks for a proof of what was written: give --apply too")
    settings = load_settings(data_dir=data_dir, connect=(connect,))
    configure_logging(as_json=settings.log_json)
    screen = Screen()
    job = asyncio.run(_calibrate(settings, kind, _parsed(options), given(more), screen, wait, write, reboot, as_json))
    if isinstance(job, int):
        return job
    return 0 if _good(job, write, require_proof) else EXIT_NO


async def _calibrate(
    settings: Any,
    kind: str,
    options: dict[str, Any],
    decided: dict[str, Any],
    screen: Screen,
    wait: float,
    write: bool,
    reboot: bool,
    as_json: bool,
) -> Job | int:
    """The job as it ended, or the exit code of a run that was told to stop."""
    from service.commands.headless import earlier, heard, stoppable
    from service.core import running_service

    with stoppable() as caught:
        try:
            async with running_service(settings) as service:
                left = earlier(service)
                vehicle = await heard(service, settings.connect[0], wait)
                screen.line(f"{vehicle.identity.autopilot} {vehicle.identity.version_text} as {vehicle.id}")
                return await _calibrated(
                    service, vehicle, left, kind, options, decided, screen, wait, write, reboot, as_json
                )
        except asyncio.CancelledError:
            if not caught:
                raise
            return 128 + caught[0]


async def _calibrated(
    service: Service,
    vehicle: Vehicle,
    left: Earlier,
    kind: str,
    options: dict[str, Any],
    decided: dict[str, Any],
    screen: Screen,
    wait: float,
    write: bool,
    reboot: bool,
    as_json: bool,
) -> Job:
    """Recover what an earlier run left, then one job from its start to its end."""
    from service.api.views import job_model
    from service.commands.headless import put_down, recovered, tidied, told_of

    resolved = await recovered(service, vehicle, left, screen)
    _require_resolved(resolved)
    job = await service.jobs.submit(vehicle.id, kind, options, decided)
    typing = asyncio.create_task(_answer_typed_lines(service, job.id))
    try:
        job = await _carried(service, vehicle, job.id, screen, wait, write, reboot)
    except asyncio.CancelledError:
        await put_down(service, job.id, service.settings.connect[0], screen)
        raise
    finally:
        typing.cancel()
        with suppress(asyncio.CancelledError):
            await typing
    await tidied(service)
    if as_json:
        write_json({**job_model(job).model_dump(), "recovered": [told_of(found) for found in resolved]})
    _show_end(job, screen, written=write)
    return job


async def _carried(
    service: Service, vehicle: Vehicle, job_id: str, screen: Screen, wait: float, write: bool, reboot: bool
) -> Job:
    """The job, once nothing goes on with it by itself."""
    from service.commands.headless import follow
    from service.jobs.model import Accept
    from service.jobs.states import JobState

    job = await follow(service, job_id, screen)
    if job.state is not JobState.REVIEW or job.plan is None:
        return job
    _show_plan(job.plan, screen)
    if not write or job.plan.blockers:
        return job
    await _writable(vehicle, wait)
    after = service.store.last_event_id()
    await service.jobs.apply(job_id, Accept(job.plan.sha256, reboot=reboot), None)
    return await follow(service, job_id, screen, after)


def _require_resolved(resolved: Sequence[Unfinished]) -> None:
    """Raise PhysicalJobRunning, with every parameter, if an earlier job is still in doubt."""
    from service.errors import PhysicalJobRunning
    from service.jobs.recovery import ending

    for found in resolved:
        if not found.ended:
            raise PhysicalJobRunning("; ".join(ending(found)) + ". Nothing new is begun until that is resolved.")


def _good(job: Job, write: bool, require_proof: bool) -> bool:
    """Whether the job has reached what was asked for."""
    from service.jobs.model import Result
    from service.jobs.proof import ProofLevel
    from service.jobs.states import JobState

    if job.plan is not None and job.plan.blockers:
        return False
    if not write:
        return job.state in {JobState.REVIEW, JobState.SUCCEEDED}  # it succeeds at once where nothing is to be changed
    proved = isinstance(job.outcome, Result) and job.outcome.proof is ProofLevel.FULL
    unneeded = job.plan is not None and job.plan.nothing_to_write
    return job.state is JobState.SUCCEEDED and (proved or unneeded or not require_proof)


async def _writable(vehicle: Vehicle, wait: float) -> None:
    """Give the vehicle time to have been disarmed for long enough; what else stands in the way is said by apply."""
    with suppress(TimeoutError):
        async with asyncio.timeout(min(wait, PATIENCE_S)):
            while not vehicle.writable().ok:  # noqa: ASYNC110 - time alone changes it
                await asyncio.sleep(0.1)


async def _answer_typed_lines(service: Service, job_id: str) -> None:
    from service.errors import ServiceError

    if not sys.stdin.isatty():
        return
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    while line := (await reader.readline()).decode().strip():
        try:
            await service.jobs.answer(job_id, line)
        except ServiceError as error:
            click.echo(f"    {error}", err=True)


def _show_plan(plan: WritePlan, screen: Screen) -> None:
    from calib.firmware.values import shown

    for text in (*plan.warnings, *(f"will not be written: {b}" for b in plan.blockers)):
        screen.line(f"    note: {text}")
    for change in plan.changes:
        old = "-" if change.old is None else shown(change.old, 6)
        sd = "" if change.sd is None else f" +- {change.sd:.2g}"
        screen.line(f"    {change.name:18} {old:>12} -> {shown(change.new, 6)}{sd} {change.unit}".rstrip())
    for loss in plan.losses:
        screen.line(f"    cannot be held: {loss.text} ({loss.cost:.3g} {loss.unit})")


def _show_end(job: Job, screen: Screen, *, written: bool) -> None:
    from service.jobs.model import Failure

    if isinstance(job.outcome, Failure):
        screen.line(f"{job.state.value}: {job.outcome.cause} {job.outcome.remedy}", bold=True)
    elif job.outcome is not None:
        screen.line(f"{job.state.value}: {job.outcome.text}", bold=True)
        if written:
            screen.line(f"proof: {job.outcome.proof.value}")
        for open_still in job.outcome.unproved:
            screen.line(f"    {open_still.name} is not proved: {open_still.why}")
    elif job.plan is not None and job.plan.blockers:
        screen.line("blocked: nothing was written, and this plan cannot be", bold=True)
    elif not written:
        screen.line("nothing was written; --apply writes it", bold=True)


def _parsed(options: tuple[str, ...]) -> dict[str, Any]:
    parsed: dict[str, Any] = {}
    for item in options:
        name, equals, value = item.partition("=")
        try:
            parsed[name.strip()] = json.loads(value)
        except ValueError:
            equals = ""
        if not equals:
            raise click.UsageError(f"{item!r} is not NAME=VALUE with a number, true or false", ctx=None)
    return parsed
