"""What a notebook does with a recording: fit it, see the bare sensor, and save the results."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mavcal.calib.converted import c_header
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.export import write_export
from mavcal.calib.firmware.in_force.fingerprint import fingerprint
from mavcal.calib.fit import FitResult
from mavcal.calib.gap import GapReport, simulator_of
from mavcal.calib.gap.export import exported, target_of
from mavcal.calib.gap_report import gap_to_html
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.source import Source
from mavcal.calib.recording import Recording
from mavcal.calib.report import to_json

HEADER = ".h"
JSON = ".json"
PAGE = ".html"


def bare(recording: Recording) -> Recording:
    """The recording with the calibration in force undone: what the bare sensors measured.

    A recording that is of no ArduPilot or PX4 comes back as it is. Channels that cannot be undone keep their stage.
    """
    return Source.of(recording, None).recording


def fit_recording(recording: Recording | Sequence[Recording], method: str, **options: Any) -> tuple[FitResult, ...]:
    """The fits of every instance that the recording has, by one of :data:`mavcal.calib.METHODS`.

    Parameters
    ----------
    recording
        As it was read; the calibration in force is undone here. Several logs of one vehicle where the method pools.
    method
        Its name, such as ``mag-ellipsoid``; ``mavcal fit --help`` lists them.
    **options
        Those of the method, such as ``instance=0``; ``METHODS[name].options`` lists them.

    Raises
    ------
    InvalidInputError
        If there is no such method or option, or the recording lacks the sensor.
    """
    if method not in METHODS:
        raise InvalidInputError(f"there is no method {method!r}; the methods are {', '.join(METHODS)}")
    recordings = (recording,) if isinstance(recording, Recording) else tuple(recording)
    return METHODS[method].run_pooled(recordings, options)


def save_fits(fits: Sequence[FitResult], path: Path | str, recording: Recording | None = None) -> int:
    """Write the fits in the format of the file's ending; returns the number of parameters, or of fits.

    Parameters
    ----------
    fits
        What :func:`fit_recording` returned.
    path
        ``.param``, ``.parm`` or ``.params``: parameters of the vehicle for a ground station. ``.h``: C arrays.
        ``.json``: everything.
    recording
        Whose parameters and board the parameter file starts from; only parameter files need it.

    Raises
    ------
    InvalidInputError
        If a parameter file is asked for without a recording of a vehicle.
    FirmwareError
        If the ending is unknown, or the vehicle cannot hold the fits.
    OSError
        If the file cannot be written.
    """
    out = Path(path)
    if out.suffix == HEADER:
        return _written(out, c_header(fits), len(fits))
    if out.suffix == JSON:
        return _written(out, json.dumps(to_json(tuple(fits)), indent=1, allow_nan=False) + "\n", len(fits))
    if recording is None or not recording.parameters:
        raise InvalidInputError(f"{out.name} needs a recording with the vehicle's parameters; .json and .h need none")
    parameters = recording.parameters.final()
    plan = compose(fits, parameters, fingerprint(recording.identity, parameters))
    write_export(plan, out)
    return len(plan.changes)


def save_report(report: GapReport, path: Path | str, recording: Recording | None = None) -> tuple[str, ...]:
    """Write a gap report in the format of the file's ending; returns what the format cannot hold, in words.

    Parameters
    ----------
    report
        What :func:`mavcal.calib.diagnose` returned.
    path
        ``.html``: a page with pictures. ``.parm`` or ``.param``: SIM_* of ArduPilot's simulator. ``.params``: SIH_*
        of PX4's. ``.sdf``: Gazebo. ``.m``: MATLAB. ``.json``: sensor errors for ``mavcal simulate recording --params``.
    recording
        The diagnosed recording; every format but the page needs it.

    Raises
    ------
    InvalidInputError
        If the ending is unknown, or the format needs the recording and there is none.
    OSError
        If the file cannot be written.
    """
    out = Path(path)
    if out.suffix == PAGE:
        _written(out, gap_to_html(report), 1)
        return ()
    target = target_of(out.name)
    if recording is None:
        raise InvalidInputError(f"{out.name} needs the recording that was diagnosed; only .html does without it")
    made = exported(report, recording, target, base=simulator_of(recording, None))
    _written(out, made.text, 1)
    return (*made.not_held, *(f"doubtful: {text}" for text in made.doubtful))


def _written(out: Path, text: str, count: int) -> int:
    out.write_text(text, encoding="utf-8", newline="\n")
    return count
