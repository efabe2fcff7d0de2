"""``mavcal campaign``: the same preflight, calibration, fit or diagnosis for many vehicles or a folder of logs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mavcal.service.commands.calibrate import KINDS, parsed
from mavcal.service.commands.campaign_items import show_items
from mavcal.service.commands.campaign_output import OutputOptions
from mavcal.service.commands.config import load_settings
from mavcal.service.commands.headless import Begun
from mavcal.service.commands.output import json_option
from mavcal.service.commands.plan_options import given, options_of_plan, plan_options
from mavcal.service.commands.reading import reading_options, split_reading
from mavcal.service.commands.remote import may_be_remote
from mavcal.service.commands.whom import Whom, data_dir_option, whom_options

if TYPE_CHECKING:
    from mavcal.client import AsyncClient
    from mavcal.service.campaigns.archive import Archive
    from mavcal.service.jobs.core.model import Job


OUTCOMES = (
    *("waiting", "running", "done", "warned", "review"),
    *("refused", "skipped", "failed", "in_doubt", "cancelled"),
)
"""Those of ``service.campaigns.items``, stated here so that help does without them (a test compares them)."""

at_once_option = click.option("--at-once", type=click.IntRange(1, 1000), default=None, help="Most items at a time.")
vehicles_options = whom_options(campaign=True, wait_help="How long to wait for vehicles, s.")
csv_option = click.option(
    "--csv", "table", type=click.Path(path_type=Path, dir_okay=False), default=None, help="Write the outcome as CSV."
)
executor_option = click.option(
    "--executor",
    default="threads",
    show_default=True,
    metavar="NAME",
    help="threads[:N], processes[:N], dask:ADDRESS, or MODULE:FACTORY of any concurrent.futures.Executor.",
)
glob_option = click.option("--glob", "pattern", default="*", show_default=True, help="Only files whose name matches.")


@click.group()
def command() -> None:
    """One preflight, calibration, fit or diagnosis for many vehicles, or for every log in a folder, as one job.

    No item ends a campaign: each gets an outcome in words. A campaign that was stopped goes on with `resume`. Exit
    code 0: every item is done. 1: an item is not. 3: nothing else but a preflight warns.
    """


@command.command()
@vehicles_options
@at_once_option
@csv_option
@json_option
def preflight(*, whom: Whom, at_once: int | None, table: Path | None, as_json: bool) -> int:
    """Check every vehicle that is heard on these endpoints, or by the service; nothing is written."""
    from mavcal.service.commands.campaign_run import run_vehicles

    async def begin(client: AsyncClient, chosen: list[str]) -> Begun:
        return Begun(await client.start_preflight_campaign(vehicles=chosen, at_once=at_once))

    return run_vehicles(whom, begin, OutputOptions(table, as_json))


@command.command()
@click.argument("kind", type=click.Choice(KINDS))
@vehicles_options
@click.option("--apply", "write", is_flag=True, help="Write every plan that nothing stands against.")
@click.option("--reboot", is_flag=True, help="With --apply: restart a vehicle whose plan needs it.")
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the procedure.")
@plan_options
@at_once_option
@csv_option
@json_option
def calibrate(
    kind: str,
    *,
    whom: Whom,
    write: bool,
    reboot: bool,
    options: tuple[str, ...],
    at_once: int | None,
    table: Path | None,
    as_json: bool,
    **more: Any,
) -> int:
    """Calibrate every vehicle that is heard; without --apply their plans wait in review."""
    if reboot and not write:
        raise click.UsageError("--reboot is a part of writing: give --apply too")
    from mavcal.service.commands.campaign_run import run_vehicles

    asked, plan = parsed(options), options_of_plan(given(more))

    async def begin(client: AsyncClient, chosen: list[str]) -> Begun:
        made = client.start_calibration_campaign(
            vehicles=chosen, kind=kind, options=asked, plan_options=plan, apply=write, reboot=reboot, at_once=at_once
        )
        return Begun(await made)

    return run_vehicles(whom, begin, OutputOptions(table, as_json))


@command.command()
@click.argument("method")
@click.argument("folder", type=click.Path(path_type=Path))
@glob_option
@click.option("--option", "options", multiple=True, metavar="NAME=VALUE", help="Option of the method.")
@reading_options
@executor_option
@at_once_option
@csv_option
@data_dir_option
@json_option
def fit(
    method: str,
    folder: Path,
    pattern: str,
    *,
    options: tuple[str, ...],
    executor: str,
    at_once: int | None,
    data_dir: Path | None,
    table: Path | None,
    as_json: bool,
    **more: Any,
) -> int:
    """Run one METHOD of `mavcal fit` on every log below FOLDER. Each is read in a child process with limits."""
    from mavcal.service.commands.campaign_archive import run_archive

    chosen, reading = parsed(options, words=True), split_reading(more)[0]

    async def begin(found: Archive) -> Job:
        return await found.fit(folder, pattern, method, chosen, reading=reading, at_once=at_once)

    return run_archive(load_settings(data_dir=data_dir, connect=()), executor, begin, OutputOptions(table, as_json))


@command.command()
@click.argument("folder", type=click.Path(path_type=Path))
@glob_option
@click.option("--sim", type=click.Path(path_type=Path), default=None, help="A simulator's recording, for all of them.")
@click.option(
    "--nominal", type=click.Path(path_type=Path), multiple=True, help="A recording without an effect; repeated."
)
@reading_options
@executor_option
@at_once_option
@csv_option
@data_dir_option
@json_option
def gap(
    folder: Path,
    pattern: str,
    sim: Path | None,
    nominal: tuple[Path, ...],
    *,
    executor: str,
    at_once: int | None,
    data_dir: Path | None,
    table: Path | None,
    as_json: bool,
    **more: Any,
) -> int:
    """Diagnose the sim-to-real gap of every log below FOLDER. Exit code 1 also if one could not be tested."""
    from mavcal.service.commands.campaign_archive import run_archive
    from mavcal.service.commands.reading import readable_file

    for path in (*(() if sim is None else (sim,)), *nominal):
        readable_file(str(path))
    reading = split_reading(more)[0]

    async def begin(found: Archive) -> Job:
        return await found.gap(folder, pattern, sim, nominal, reading=reading, at_once=at_once)

    return run_archive(load_settings(data_dir=data_dir, connect=()), executor, begin, OutputOptions(table, as_json))


@command.command()
@click.argument("job")
@whom_options(campaign=True, chosen=False, optional=True, wait_help="How long to wait for vehicles, s.")
@executor_option
@csv_option
@json_option
def resume(job: str, *, whom: Whom, executor: str, table: Path | None, as_json: bool) -> int:
    """Go on with a campaign that was stopped; what has ended is not done again."""
    from mavcal.service.commands.campaign_archive import is_of_folder, run_archive
    from mavcal.service.commands.campaign_run import resumed, run_vehicles

    output = OutputOptions(table, as_json)
    if whom.url is None and is_of_folder(whom.settings.data_dir, job):

        async def begin(found: Archive) -> Job:
            return await found.resume(job)

        return run_archive(whom.settings, executor, begin, output)
    return run_vehicles(whom, resumed(job), output)


@command.command()
@click.argument("job")
@click.option(
    "--outcome", "outcomes", type=click.Choice(OUTCOMES), multiple=True, help="Only items that ended so; repeated."
)
@csv_option
@data_dir_option
@may_be_remote
@json_option
def items(
    job: str,
    outcomes: tuple[str, ...],
    *,
    table: Path | None,
    data_dir: Path | None,
    url: str | None,
    key_file: Path | None,
    as_json: bool,
) -> int:
    """List the items of a campaign.

    Without --url the data directory is read; a service may go on with it meanwhile.
    """
    whom = Whom(url=url, key_file=key_file, data_dir=data_dir)
    whom.require_sense(needed="", alone=False, of_links=True)
    return show_items(whom, job, outcomes, OutputOptions(table, as_json))
