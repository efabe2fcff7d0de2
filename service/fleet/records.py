"""Turns jobs and preflights into rows of the fleet's tables, and rows back into records."""

from __future__ import annotations

from collections.abc import Iterable

import structlog

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult
from mavcal.calib.fleet.record import ObservationSource, SensorRecord, bias_of
from mavcal.calib.fleet.standing import FailedCheck, LastPreflight
from mavcal.calib.preflight.check import Check, Verdict, VerifiedCalibration
from mavcal.calib.preflight.history import calibrates_gyros, covered_by
from mavcal.calib.recording import Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.service.jobs.calibrate.history import history_of
from mavcal.service.jobs.core.model import Job, Result
from mavcal.service.jobs.core.proof import ProofLevel
from mavcal.service.preflights import Preflight
from mavcal.service.store.rows import PreflightRow, SensorRow
from mavcal.service.store.sql import Store

log = structlog.get_logger(__name__)

REST = "rest"
"""Name of a preflight as a measurement of a sensor."""


def records_of_job(job: Job, store: Store) -> tuple[SensorRecord, ...]:
    """Records of the sensors from a successful calibration. Reads the store: not for the event loop."""
    left = next(iter(history_of((job,), store)), None)
    if left is None or job.plan is None or job.vehicle_id is None:
        return ()
    return tuple(_of_fit(job, fit, left) for fit in job.results if fit.sensor in left.sensors)


def _of_fit(job: Job, fit: FitResult, left: VerifiedCalibration) -> SensorRecord:
    assert job.plan is not None
    assert job.vehicle_id is not None
    place = (fit.sensor, fit.instance)
    written = any((c.sensor, c.instance) == place and not c.session for c in job.plan.changes)
    agreed = any((a.sensor, a.instance) == place for a in job.plan.agreements)
    proved = isinstance(job.outcome, Result) and job.outcome.proof != ProofLevel.NONE
    autopilot = job.plan.fingerprint.autopilot
    found = bias_of(fit)
    measured = left.temperatures.get(fit.instance) if fit.sensor == Sensor.ACCEL else fit.temperature
    inertial = fit.sensor in (Sensor.ACCEL, Sensor.GYRO)
    return SensorRecord(
        job.vehicle_id,
        autopilot,
        fit.sensor,
        fit.instance,
        left.device_ids.get(f"{fit.sensor}{fit.instance}", 0),
        left.at,
        ObservationSource.JOB,
        job.id,
        job.kind,
        applied=written or agreed,
        proved=agreed or (written and proved),
        bias=None if found is None else found[0],
        sd=None if found is None else found[1],
        temperature=fit.temperature,
        covered=covered_by(autopilot, left.parameters, fit.sensor, fit.instance, measured) if inertial else None,
        by_itself=fit.sensor == Sensor.GYRO and calibrates_gyros(autopilot, left.parameters),
    )


def records_of_preflight(found: Preflight, source_id: str) -> tuple[SensorRecord, ...]:
    """Records of the inertial units from a preflight."""
    return tuple(
        SensorRecord(
            found.vehicle_id,
            found.identity.autopilot or "",
            reading.sensor,
            reading.instance,
            reading.device_id,
            found.at,
            ObservationSource.PREFLIGHT,
            source_id,
            REST,
            proved=reading.bias is not None,
            bias=reading.bias,
            sd=None if reading.bias is None else reading.sd,
            norm=reading.norm,
            temperature=reading.temperature,
            by_itself=reading.by_itself,
        )
        for reading in found.readings
        if reading.sensor in CALIBRATED
    )


def sensor_row(record: SensorRecord) -> SensorRow:
    """The record as the store keeps it."""
    place = (record.source_id, record.sensor.value, record.instance, record.source.value)
    return SensorRow(*place, record.unit, record.at, to_json(record))


def records_of_rows(rows: Iterable[SensorRow]) -> tuple[SensorRecord, ...]:
    """The records that :func:`sensor_row` made rows of; a damaged one is left out and logged."""
    found = []
    for row in rows:
        try:
            found.append(from_json(row.body, SensorRecord))
        except CalibError as error:
            log.error("a sensor's record is damaged", source=row.source_id, unit=row.unit_id, reason=str(error))
    return tuple(found)


def preflight_row(found: Preflight) -> PreflightRow:
    """The report as the store keeps it."""
    report = found.report
    body = {"summary": report.summary, "checks": to_json(report.checks), "notes": list(found.notes)}
    return PreflightRow(found.vehicle_id, found.at, report.verdict.value, body)


def last_preflight(row: PreflightRow) -> LastPreflight | None:
    """The report for the reasons; None: its row is damaged."""
    try:
        checks = [from_json(check, Check) for check in row.body.get("checks", ())]
        failed = tuple(FailedCheck(c.id, c.verdict, c.reason) for c in checks if c.verdict != Verdict.PASS)
        return LastPreflight(row.at, Verdict(row.verdict), failed)
    except (CalibError, ValueError, TypeError) as error:
        log.error("a preflight's record is damaged", unit=row.unit_id, reason=str(error))
        return None
