"""Routes of vehicles: their state, live samples, preflights, and putting the last verified calibration back.

The state of the calibrations comes from jobs, and from what a vehicle has said so far. A watch has a vehicle send its
live samples.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from mavcal.calib.preflight.check import Snapshot
from mavcal.calib.preflight.states import FinishedCalibration, SensorState, sensor_states
from mavcal.calib.recording import Channel, Recording
from mavcal.service.api.dependencies import MadeDep, ServiceDep
from mavcal.service.api.models.jobs import JobModel
from mavcal.service.api.models.live import LiveModel, SamplesModel, WatchModel, WatchRequest
from mavcal.service.api.models.preflight import PreflightModel, PreflightRequest, RestoreRequest
from mavcal.service.api.models.vehicles import (
    HandRequest,
    ParameterModel,
    TurnRequest,
    VehicleModel,
    VehicleSensorsModel,
)
from mavcal.service.api.security import OPERATE, READ, ActorDep, Scope, SightDep, require
from mavcal.service.api.views import job_model, parameter_model, preflight_model, sensors_model, vehicle_model
from mavcal.service.core import Service
from mavcal.service.fixing import Fix, Fixable, fixed
from mavcal.service.jobs.calibrate.history import history_of, verified_jobs
from mavcal.service.live import LiveBatch, live_batches
from mavcal.service.rates.watching import LiveStatus
from mavcal.service.vehicle.job_vehicle import JobVehicle
from mavcal.service.vehicle.rate_ledger import LiveWatch
from mavcal.service.vehicle.vehicle import Vehicle

router = APIRouter(tags=["vehicles"])
STATE_PERIOD_S = 1.0


async def states_of(service: Service, vehicle_id: str) -> tuple[SensorState, ...]:
    """The four states, compared with parameters heard so far; nothing is requested from the vehicle."""
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


@router.post(
    "/vehicles/{vehicle_id}/watches",
    operation_id="watch_vehicle",
    status_code=201,
    dependencies=[OPERATE],
)
async def watch_vehicle(found: VehicleDep, body: WatchRequest, made: MadeDep, service: ServiceDep) -> WatchModel:
    """Have the vehicle send its samples for as long as `follow_samples` is read with this watch.

    Its former message rates are put back when the last watch is over, at once when it arms, and before a job chooses
    its own. It is asked for nothing while it is armed or silent, or while a job runs.
    """
    begun = service.live.begin(found.id, body.rate_hz)
    made.at(f"api/v1/vehicles/{found.id}/samples?watch={begun.id}")
    return WatchModel(id=begun.id, rate_hz=begun.rate_hz)


def _watch(
    found: VehicleDep,
    service: ServiceDep,
    watch: Annotated[
        str | None, Query(description="a watch of this vehicle; without one it is asked for nothing")
    ] = None,
) -> LiveWatch | None:
    """The watch of the request. A stream can answer 404 only here, before it begins."""
    return None if watch is None else service.live.watch(watch, found.id)


@router.get(
    "/vehicles/{vehicle_id}/samples",
    operation_id="follow_samples",
    response_class=EventSourceResponse,
    dependencies=[READ],
)
async def samples(
    found: VehicleDep, service: ServiceDep, watch: Annotated[LiveWatch | None, Depends(_watch)]
) -> AsyncIterator[ServerSentEvent]:
    """What the sensors read, ten times a second, as the vehicle streams it."""
    try:
        async with aclosing(live_batches(found)) as batches:  # type: ignore[type-var]
            async for batch in batches:
                status = None if watch is None else service.live.taken(watch)
                yield ServerSentEvent(data=_model(batch, status), event="samples")
    finally:
        if watch is not None:
            service.live.left(watch)


def _model(batch: LiveBatch, status: LiveStatus | None) -> LiveModel:
    return LiveModel(
        channels=_samples(batch.channels),
        bare=_samples(batch.bare),
        attitude=batch.attitude,
        model_field_ut=batch.field,
        loss=batch.loss,
        watch=status,
    )


def _samples(channels: Sequence[Channel]) -> list[SamplesModel]:
    return [
        SamplesModel(
            sensor=channel.sensor,
            instance=channel.instance,
            unit=channel.unit,
            source=channel.source,
            t=np.round(channel.t, 4).tolist(),
            values=[[_digits(value) for value in axis] for axis in channel.values.T.tolist()],
        )
        for channel in channels
    ]


def _digits(value: float) -> float | None:
    """`value` with six significant digits: no sensor has more, and a phone's link is slow."""
    return float(f"{value:.6g}") if np.isfinite(value) else None


@router.post("/vehicles/{vehicle_id}/preflight", operation_id="run_preflight", dependencies=[OPERATE])
async def run(
    vehicle_id: str, body: PreflightRequest, request: Request, service: ServiceDep, actor: ActorDep
) -> PreflightModel:
    """Check a vehicle that stands still, in ten seconds (30 on a slow link).

    409 while it is armed, silent, or has a job running.
    """
    service.vehicles.get(vehicle_id)
    mended: tuple[Fix, ...] = ()
    if body.fix:
        await require(Scope.WRITE_PARAMS)(request)
        mended = await fixed(service.jobs, vehicle_id, [Fixable(kind) for kind in body.fix], actor=actor)
    return preflight_model(await service.jobs.preflight(vehicle_id, heading=body.heading), mended)


@router.post(
    "/vehicles/{vehicle_id}/restore", operation_id="restore_calibration", status_code=202, dependencies=[OPERATE]
)
async def restore(vehicle_id: str, body: RestoreRequest, made: MadeDep, service: ServiceDep) -> JobModel:
    """Plan to put the last verified calibration of this unit back, mapped by device id; `apply` writes the plan.

    409 if no calibration of this very unit was verified here.
    """
    return made(job_model(await service.jobs.restore(vehicle_id, body.given())))
