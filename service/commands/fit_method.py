"""``mavcal fit METHOD FILE``: the command of a method, made from what the method says of itself."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from mavcal.calib.converted import Convention, Converted, c_header, converted
from mavcal.calib.errors import CalibError
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.methods.method import FindingKind, Method
from mavcal.calib.recording import Recording
from mavcal.service.commands.output import EXIT_NO, json_option, write_file, write_json, writing
from mavcal.service.commands.reading import face_option, read_recording, reading_options, split_reading

HEADER = ".h"
"""Ending of an export that is no parameter file but C."""


def command_of(method: Method) -> click.Command:
    """The command that runs `method`."""

    @click.argument("files", nargs=-1, metavar="[FILE]..." if method.pool else "[FILE]")
    @face_option
    @click.option(
        "--export",
        type=click.Path(path_type=Path, dir_okay=False),
        help="Write .param, .parm or .params; .h is the correction as a homogeneous 4x4 array of C.",
    )
    @click.option(
        "--as", "as_form", type=click.Choice([c.value for c in Convention]), help="Add the fit in another's form."
    )
    @reading_options
    @json_option
    def run(
        files: tuple[str, ...],
        faces: tuple[tuple[str, str], ...],
        export: Path | None,
        as_form: str | None,
        as_json: bool,
        **options: Any,
    ) -> int:
        reading, chosen = split_reading(options)
        if len(files) > 1 and method.pool is None:
            raise click.UsageError(f"{method.name} takes one FILE, not {len(files)}")
        if len(files) > 1 and faces:
            raise click.UsageError("give either FILEs, or --face LABEL=FILE for every face")
        if as_form is not None:
            require_correction(method)
        if export is not None:
            require_place(export)
            require_exportable(method, export)
        recordings = [read_recording(file, faces, reading) for file in (files or (None,))]
        recording = recordings[-1]  # whose parameters are the newest: export starts from them
        if export is not None:
            require_vehicle(export, recording)
        fits = method.run_pooled(recordings, {k: v for k, v in chosen.items() if v is not None})
        failed = ""
        try:
            if export is not None:
                _export(recording, fits, export)
        except (click.ClickException, CalibError) as error:
            failed = str(error)
        finally:  # whatever became of the export, the fit is told
            _print_fits(fits, as_form, failed, as_json=as_json)
        return EXIT_NO if failed or any(fit.status == FitStatus.REFUSED for fit in fits) else 0

    made = click.command(method.name, help=f"{method.summary}\n\nNeeds: {method.needs}")(run)
    made.params += [
        click.Option(
            [f"--{option.name.replace('_', '-')}", option.name],
            type=click.Choice(list(option.type)) if isinstance(option.type, tuple) else option.type,
            default=None,
            help=f"{option.help} [default: {option.default}]" if option.default is not None else option.help,
        )
        for option in method.options
    ]
    return made


def _print_fits(fits: tuple[FitResult, ...], convention: str | None, failed: str, *, as_json: bool) -> None:
    """Print the fits; `failed` says why they were not exported."""
    if failed:
        click.echo(f"mavcal: {failed}", err=True)
    forms = [None if convention is None else _converted(fit, convention) for fit in fits]
    if as_json:
        document = _document(fits, forms)
        write_json({**document, "export": {"error": failed}} if failed else document)
        return
    for fit, form in zip(fits, forms, strict=True):
        _show(fit)
        if form is not None:
            _show_form(form)


def _converted(fit: FitResult, convention: str) -> Converted | None:
    """The fit in that convention; None: it was refused."""
    return None if fit.status == FitStatus.REFUSED else converted(fit, convention)


def _document(fits: tuple[FitResult, ...], forms: Sequence[Converted | None]) -> dict[str, Any]:
    """The only fit, or the first one with all of them under ``fits``."""
    from mavcal.calib.report import to_json

    documents = to_json(fits)
    for document, form in zip(documents, forms, strict=True):
        if form is not None:
            document["converted"] = to_json(form)
    return documents[0] if len(documents) == 1 else {**documents[0], "fits": documents}


def require_place(out: Path) -> None:
    """Refuse what cannot be written whatever the fit says: an unknown ending, a folder that is not there."""
    from mavcal.calib.firmware.export import ParameterFormat

    endings = [*(f".{form}" for form in ParameterFormat), HEADER]
    if out.suffix not in endings:
        raise click.UsageError(f"--export {out.name}: a file ends in {', '.join(endings)}")
    if not out.parent.is_dir():
        raise click.UsageError(f"--export {out}: there is no folder {out.parent}")


def require_exportable(method: Method, out: Path) -> None:
    """Refuse an export that cannot hold what the method finds, whatever the recording says."""
    if method.finds is FindingKind.FIGURES:
        raise click.UsageError(f"--export {out.name}: {method.name} finds {method.finds}. --json tells them")
    if out.suffix == HEADER and method.finds is not FindingKind.CORRECTION:
        raise click.UsageError(
            f"--export {out.name}: {method.name} finds {method.finds}, which a constant array does not hold. "
            "Export parameters (.param), or take --json"
        )


def require_correction(method: Method) -> None:
    """Refuse another convention for a result that is no correction."""
    if method.finds in {FindingKind.FIGURES, FindingKind.MOTORS}:
        raise click.UsageError(f"--as: {method.name} finds {method.finds}, which has no other form. --json tells it")


def require_vehicle(out: Path, recording: Recording) -> None:
    """Refuse parameters for a recording that does not say whose they would be, before the fit is made."""
    from mavcal.calib.firmware.in_force.fingerprint import SENSOR_IDS

    if out.suffix == HEADER:
        return
    if recording.identity.autopilot not in SENSOR_IDS:
        why = "the recording does not say which autopilot it is of (a table never does)"
    elif not recording.parameters:
        why = "the recording holds no parameters, so the fit is relative to a calibration that is not known"
    else:
        return
    raise click.UsageError(f"--export {out.name}: {why}. Export to {HEADER}, or leave --export out")


def _export(recording: Recording, fits: tuple[FitResult, ...], out: Path) -> None:
    if out.suffix == HEADER:
        write_file(out, c_header(fits))
        return
    from mavcal.calib.firmware.compose.plan import compose
    from mavcal.calib.firmware.export import write_export
    from mavcal.calib.firmware.in_force.fingerprint import fingerprint

    parameters = recording.parameters.final()
    plan = compose(fits, parameters, fingerprint(recording.identity, parameters))
    if plan.blockers:
        raise click.ClickException(f"not exported: {'; '.join(plan.blockers)}")
    with writing(out):
        write_export(plan, out)
    click.echo(f"{out}: {len(plan.changes)} parameters", err=True)


def _show(fit: FitResult) -> None:
    click.echo(f"{fit.method} {fit.sensor.value}[{fit.instance}]: {fit.status.value}. {fit.message}")
    if fit.status == FitStatus.REFUSED:
        return
    for name, value, sd in zip(fit.names, fit.values, fit.sd, strict=True):
        if name in fit.undetermined:
            click.echo(f"  {name:12} undetermined")
        elif sd > 0:
            click.echo(f"  {name:12} {value: .9g} +- {sd:.2g}")
    relative = " (relative to the calibration in force, which is not known)" if fit.relative else ""
    click.echo(f"  residual {fit.residual_rms:.4g} {fit.unit} over {fit.n_used} of {fit.n_samples} samples{relative}")
    for warning in fit.warnings:
        click.echo(f"  ! {warning}")


def _show_form(form: Converted) -> None:
    click.echo(f"  {form.convention.value}: {form.form}")
    for name, value in form.values.items():
        click.echo(f"    {name} = {value}")
    for text in form.lost:
        click.echo(f"    ! left out: {text}")
