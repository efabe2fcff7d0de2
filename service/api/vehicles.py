"""Routes of vehicles."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from fastapi import APIRouter, Depends
from fastapi.sse import EventSourceResponse, ServerSentEvent

from service.api.dependencies import ServiceDep
from service.api.models import ParameterModel, VehicleModel
from service.api.security import Scope, require
from service.api.views import parameter_model, vehicle_model

router = APIRouter(tags=["vehicles"])
READ = Depends(require(Scope.READ))

STATE_PERIOD_S = 1.0


@router.get("/vehicles", dependencies=[READ])
async def vehicles(service: ServiceDep) -> list[VehicleModel]:
    """Every vehicle that was heard."""
    return [vehicle_model(v) for v in service.vehicles.all()]


@router.get("/vehicles/{vehicle_id}", dependencies=[READ])
async def vehicle(vehicle_id: str, service: ServiceDep) -> VehicleModel:
    """One vehicle."""
    return vehicle_model(service.vehicles.get(vehicle_id))


@router.get("/vehicles/{vehicle_id}/parameters", dependencies=[READ])
async def parameters(vehicle_id: str, service: ServiceDep, refresh: bool = False) -> list[ParameterModel]:
    """The vehicle's parameters as heard last; `refresh` lists them again first."""
    found = service.vehicles.get(vehicle_id)
    if refresh or not found.parameters:
        await found.list_parameters()
    return [parameter_model(p) for _, p in sorted(found.parameters.items())]


@router.get("/vehicles/{vehicle_id}/stream", response_class=EventSourceResponse, dependencies=[READ])
async def stream(vehicle_id: str, service: ServiceDep) -> AsyncIterator[ServerSentEvent]:
    """The vehicle's state, once a second."""
    while True:
        yield ServerSentEvent(data=vehicle_model(service.vehicles.get(vehicle_id)), event="vehicle")
        await asyncio.sleep(STATE_PERIOD_S)
