"""The state of a vehicle's calibrations, from its jobs and from what it has said so far."""

from __future__ import annotations

import asyncio
import time

from mavcal.calib.preflight.snapshot import Snapshot
from mavcal.calib.preflight.states import FinishedCalibration, SensorState, sensor_states
from mavcal.calib.recording import Recording
from mavcal.service.core import Service
from mavcal.service.jobs.calibrate.history import history_of, verified_jobs
from mavcal.service.vehicle.job_vehicle import JobVehicle


async def states_of(service: Service, vehicle_id: str) -> tuple[SensorState, ...]:
    """The four states; asks the vehicle for nothing, so only parameters that were heard before are compared."""
    vehicle = service.vehicles.get(vehicle_id)
    identity = JobVehicle(vehicle).identity
    jobs = verified_jobs(service.jobs.list(), vehicle_id, identity)
    parameters = {name: parameter.value for name, parameter in vehicle.parameters.items()}
    history = await asyncio.to_thread(history_of, jobs, service.store)
    snapshot = Snapshot(Recording(()), identity, parameters, time.time(), history, complete=vehicle.listed)
    finished = [
        FinishedCalibration(job.kind, job.id, job.updated_at, job.results, job.left_out, job.missed) for job in jobs
    ]
    return sensor_states(finished, snapshot)
