"""``mavcal gap``: where a real sensor differs from the simulated one, which effect causes it, how far it shrinks."""

from __future__ import annotations

import hashlib
from typing import Any

import click

from service.commands.gap_selftest import command as selftest
from service.commands.output import EXIT_NO, json_option, write_json
from service.commands.reading import readable_file, reading_options


@click.group(invoke_without_command=True)
@click.option("--real", default=None, metavar="FILE", help="The recording whose gap is asked for.  [required]")
@click.option(
    "--sim", default=None, metavar="FILE", help="A simulator's recording: of the same trajectory, or of such a flight."
)
@click.option(
    "--nominal", multiple=True, metavar="FILE", help="A recording without an effect: noise and Earth's field; repeated."
)
@reading_options
@json_option
@click.pass_context
def command(
    ctx: click.Context, /, real: str | None, sim: str | None, nominal: tuple[str, ...], as_json: bool, **reading: Any
) -> int:
    """Diagnose the sim-to-real gap of a recording or a log.

    The reference is found in the files: ref_* columns, a simulator's log of the same trajectory, a pose, other
    instances of the vehicle, or a trajectory that is estimated anew. Exit code 1 if nothing could be tested.
    """
    if ctx.invoked_subcommand is not None:
        return 0
    if real is None:
        raise click.UsageError("Missing option '--real'.")
    from calib import gap, logs
    from calib.gap.schema import as_json as document_of

    roles = ("real",) if sim is None else ("real", "sim")
    files = [readable_file(name) for name in (real, *(() if sim is None else (sim,)), *nominal)]
    first, *others = [logs.read(file, **reading) for file in files]
    simulated = others.pop(0) if sim is not None else None
    hashes = {role: hashlib.sha256(file.read_bytes()).hexdigest() for role, file in zip(roles, files, strict=False)}
    report = gap.run(first, simulated, tuple(others), inputs=hashes)
    document = document_of(report)
    if as_json:
        write_json(document)
    else:
        _show(document)
    return EXIT_NO if document["verdict"] == "not_testable" else 0


def _show(document: dict[str, Any]) -> None:
    click.echo(f"verdict: {document['verdict']}")
    for effect in document["effects"]:
        on = ", ".join(str(i) for i in effect["instances"])
        click.echo(f"{effect['id']} of instance {on}: probability {_number(effect['evidence']['probability'])}")
        for parameter in effect["params"]:
            click.echo(
                f"  {parameter['name']:12} {_number(parameter['value'])} +- {_number(parameter['se'])} "
                f"{parameter['unit']}"
            )
        for rival in effect["confusable_with"]:
            click.echo(f"  could be {rival['id']}; told apart by: {rival['fix']}")
    for gone in document["not_testable"]:
        click.echo(f"not testable: {gone['id']}: {gone['reason']}; needed: {gone['need']}")
    for warning in document["warnings"]:
        click.echo(f"! {warning}")


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.4g}"


command.add_command(selftest, "selftest")
