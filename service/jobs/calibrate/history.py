"""The verified calibrations of a vehicle, from the jobs of the store."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from mavcal.calib.errors import CalibError
from mavcal.calib.firmware import sensor_ids
from mavcal.calib.firmware.options import key_text
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import CALIBRATED, px4_sensor_ids
from mavcal.calib.preflight.check import VerifiedCalibration
from mavcal.calib.recording import Identity, Sensor
from mavcal.calib.report import from_json
from mavcal.service.jobs.calibrate.planning import stated_device_ids
from mavcal.service.jobs.core.model import RESTORE, Job
from mavcal.service.jobs.core.states import JobState
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.store.sql import Store

_SENT_WITH = dict.fromkeys((Sensor.ACCEL, Sensor.GYRO), (Sensor.ACCEL, Sensor.GYRO))
"""Sensors whose samples come in one message."""


def verified_jobs(jobs: Iterable[Job], vehicle_id: str, identity: Identity) -> tuple[Job, ...]:
    """The jobs whose calibration was verified on this vehicle, oldest first.

    A vehicle without any may carry a new board. If exactly one other unit has its system id, the jobs of that unit
    count. Their unique id tells that they are of another board.
    """
    good = [job for job in jobs if job.state == JobState.SUCCEEDED and job.plan is not None and job.vehicle_id]
    good = [job for job in good if job.kind != RESTORE]  # which puts back what another job has verified
    good.sort(key=lambda job: job.updated_at)
    own = tuple(job for job in good if job.vehicle_id == vehicle_id)
    if own:
        return own
    others = tuple(job for job in good if _same_address(job, identity))
    return others if len({job.vehicle_id for job in others}) == 1 else ()


def _same_address(job: Job, identity: Identity) -> bool:
    try:
        of = from_json(job.context.get("identity", {}), Identity)
    except CalibError:
        return False
    ours = (identity.autopilot, identity.system, identity.component)
    return identity.system is not None and (of.autopilot, of.system, of.component) == ours


def history_of(jobs: Iterable[Job], store: Store) -> tuple[VerifiedCalibration, ...]:
    """The calibrations that these jobs have verified. Reads the store: not for the event loop."""
    return tuple(_verified(job, store) for job in jobs)


def _verified(job: Job, store: Store) -> VerifiedCalibration:
    assert job.plan is not None
    kept = store.snapshot(job.id, SnapshotPurpose.COMPOSED_ON)
    parameters: Mapping[str, Value] = {} if kept is None else kept.body
    written = {change.name: change.new for change in job.plan.changes if not change.session}
    left = {**parameters, **written}
    # the values after the write: a plan may write ids, and its fingerprint is from before
    autopilot, stated = job.plan.fingerprint.autopilot, stated_device_ids(job)
    held = px4_sensor_ids(left, stated) if autopilot == "px4" else sensor_ids(autopilot, left)
    ids = {key_text(*key): device for key, device in held.items()}
    heard = {(sensor, fit.instance) for fit in job.results for sensor in _SENT_WITH.get(fit.sensor, (fit.sensor,))}
    accels = [fit for fit in job.results if fit.sensor == Sensor.ACCEL and fit.temperature is not None]
    return VerifiedCalibration(
        job=job.id,
        at=job.updated_at,
        sensors=job.plan.sensors & frozenset(CALIBRATED),
        device_ids=ids or dict(job.plan.fingerprint.device_ids),
        parameters=left,
        temperatures={fit.instance: fit.temperature for fit in accels if fit.temperature is not None},
        heard=frozenset(ids[name] for name in (key_text(*key) for key in heard) if name in ids),
        uid=job.plan.fingerprint.uid or None,
        stated=stated,
    )
