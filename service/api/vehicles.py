"""Routes of vehicles, and the state of their calibrations from jobs and from what a vehicle has said so far."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.sse import EventSourceResponse, ServerSentEvent

from mavcal.calib.preflight.snapshot import Snapshot
from mavcal.calib.preflight.states import FinishedCalibration, SensorState, sensor_states
from mavcal.calib.recording import Recording
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.vehicles import (
    HandRequest,
    ParameterModel,
    TurnRequest,
    VehicleModel,
    VehicleSensorsModel,
)
from mavcal.service.api.security import OPERATE, READ, Scope, SightDep, require
from mavcal.service.api.views import parameter_model, sensors_model, vehicle_model
from mavcal.service.core import Service
from mavcal.service.jobs.calibrate.history import history_of, verified_jobs
from mavcal.service.vehicle import Vehicle
from mavcal.service.vehicle.job_vehicle import JobVehicle

router = APIRouter(tags=["vehicles"])

STATE_PERIOD_S = 1.0


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


def _vehicle(vehicle_id: str, service: ServiceDep) -> Vehicle:
    return service.vehicles.get(vehicle_id)


VehicleDep = Annotated[Vehicle, Depends(_vehicle)]
"""The vehicle of the address. A stream can answer 404 only here, before it begins."""


@router.get("/vehicles", operation_id="list_vehicles", dependencies=[READ])
async def vehicles(service: ServiceDep, sight: SightDep) -> list[VehicleModel]:
    """Every vehicle that was heard."""
    return [vehicle_model(v) for v in service.vehicles.all() if sight.vehicle(v.id)]


@router.get("/vehicles/{vehicle_id}", operation_id="get_vehicle", dependencies=[READ])
async def vehicle(found: VehicleDep) -> VehicleModel:
    """One vehicle."""
    return vehicle_model(found)


@router.get("/vehicles/{vehicle_id}/parameters", operation_id="list_parameters", dependencies=[READ])
async def parameters(found: VehicleDep, refresh: bool = False) -> list[ParameterModel]:
    """Every parameter of the vehicle as heard last; `refresh` lists them again first."""
    if refresh or not found.listed:
        await found.list_parameters()
    return [parameter_model(p) for _, p in sorted(found.parameters.items())]


@router.get("/vehicles/{vehicle_id}/sensors", operation_id="list_sensors", dependencies=[READ])
async def sensors(vehicle_id: str, service: ServiceDep) -> VehicleSensorsModel:
    """How the calibrations of a vehicle stand, and what it needs now; asks the vehicle for nothing."""
    return sensors_model(await states_of(service, vehicle_id))


@router.post("/vehicles/{vehicle_id}/hand", operation_id="choose_hand", dependencies=[OPERATE])
async def choose_hand(found: VehicleDep, body: HandRequest, service: ServiceDep) -> VehicleModel:
    """Say who moves a simulated vehicle: it follows prompts by itself, a person turns it, or it stays as it is."""
    service.hands.choose(found, body.hand)
    return vehicle_model(found)


@router.post(
    "/vehicles/{vehicle_id}/turns",
    operation_id="turn_vehicle",
    dependencies=[Depends(require(Scope.OPERATE, noted=False))],  # many a second, and nothing real changes
)
async def turn_vehicle(found: VehicleDep, body: TurnRequest, service: ServiceDep) -> VehicleModel:
    """Turn a simulated vehicle whose hand is `mouse`; it gets there within a second or two."""
    await service.hands.turn(found, body.attitude)
    return vehicle_model(found)


@router.get(
    "/vehicles/{vehicle_id}/stream",
    operation_id="follow_vehicle",
    response_class=EventSourceResponse,
    dependencies=[READ],
)
async def stream(found: VehicleDep, service: ServiceDep, sight: SightDep) -> AsyncIterator[ServerSentEvent]:
    """The vehicle's state, once a second, as long as its link is open."""
    while found in service.vehicles.all() and sight.vehicle(found.id):
        yield ServerSentEvent(data=vehicle_model(found), event="vehicle")
        await asyncio.sleep(STATE_PERIOD_S)
