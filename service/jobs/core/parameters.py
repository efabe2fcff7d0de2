"""Reads the parameters that a job needs by name: on a slow link the whole list takes most of a minute."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping

from mavcal.calib.firmware.in_force.needed import DRIFT_KINDS, needed
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.slots import CALIBRATED
from mavcal.calib.fit import FitResult
from mavcal.calib.recording import Sensor
from mavcal.service.errors import PlanChanged
from mavcal.service.jobs.core.model import Job
from mavcal.service.vehicle.job_vehicle import JobVehicle, ParameterReading, read_values


async def read_needed(
    vehicle: JobVehicle, sensors: Collection[Sensor], *, drift: bool, progress: Callable[[int, int], None] | None = None
) -> dict[str, ParameterReading]:
    """Every parameter of the vehicle that a job over `sensors` looks at; those that it does not have are left out.

    `progress` is called with how many were answered, and of how many as far as is known.

    Raises
    ------
    ParameterTimeout, VehicleSilent, LinkDown
    FirmwareError
        If the autopilot is neither ArduPilot nor PX4.
    """
    autopilot = vehicle.identity.autopilot or ""
    asked: set[str] = set()
    found: dict[str, ParameterReading] = {}
    while True:
        known = {name: reading.value for name, reading in found.items()}
        missing = needed(autopilot, sensors, known, drift=drift) - asked
        if not missing:
            return found
        done = len(asked)
        asked |= missing

        def counted(answered: int, done: int = done, total: int = len(asked)) -> None:
            if progress is not None:
                progress(done + answered, total)

        found |= await read_values(vehicle, sorted(missing), absent=True, progress=counted)


def sensors_of(results: Iterable[FitResult]) -> set[Sensor]:
    """The sensors whose calibration these fits may change, and the inertial ones, which are in every stream."""
    return {fit.sensor for fit in results if fit.sensor in CALIBRATED} | {Sensor.ACCEL, Sensor.GYRO}


async def require_absent(
    vehicle: JobVehicle, job: Job, composed_on: Mapping[str, Value], progress: Callable[[int, int], None] | None = None
) -> None:
    """Ask again for parameters absent when `composed_on` was read: on a bad link silence may be loss.

    Raises
    ------
    PlanChanged
        If one is there: what counted as absent, and so as its default, is not.
    ParameterTimeout, VehicleSilent, LinkDown
    """
    drift = job.kind in DRIFT_KINDS and any(fit.model.polynomial is not None for fit in job.results)
    autopilot = vehicle.identity.autopilot or ""
    absent = needed(autopilot, sensors_of(job.results), composed_on, drift=drift) - composed_on.keys()
    if not absent:
        return

    def counted(answered: int) -> None:
        if progress is not None:
            progress(answered, len(absent))

    counted(0)
    there = await read_values(vehicle, sorted(absent), absent=True, progress=counted)
    if there:
        names = ", ".join(there)
        raise PlanChanged(f"{names} did not answer when the calibration was read, but does now: start the job again")
