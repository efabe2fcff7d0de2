"""Routes of live samples: their stream, and the watch that has a vehicle send them."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import aclosing
from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.sse import EventSourceResponse, ServerSentEvent

from mavcal.calib.recording import Channel
from mavcal.service.api.addresses import relative
from mavcal.service.api.dependencies import ServiceDep
from mavcal.service.api.models.live import LiveModel, SamplesModel, WatchModel, WatchRequest
from mavcal.service.api.security import OPERATE, READ
from mavcal.service.api.vehicles import VehicleDep
from mavcal.service.live import LiveBatch, live_batches
from mavcal.service.rates.watching import LiveStatus
from mavcal.service.vehicle.rate_ledger import LiveWatch

router = APIRouter(tags=["vehicles"])


@router.post(
    "/vehicles/{vehicle_id}/watches",
    operation_id="watch_vehicle",
    status_code=201,
    dependencies=[OPERATE],
)
async def watch_vehicle(
    found: VehicleDep, body: WatchRequest, request: Request, response: Response, service: ServiceDep
) -> WatchModel:
    """Have the vehicle send its samples for as long as `follow_samples` is read with this watch.

    Its former message rates are put back when the last watch is over, at once when it arms, and before a job chooses
    its own. It is asked for nothing while it is armed or silent, or while a job runs.
    """
    begun = service.live.begin(found.id, body.rate_hz)
    response.headers["Location"] = relative(request, f"api/v1/vehicles/{found.id}/samples?watch={begun.id}")
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
    """Six significant digits: no sensor has more, and a phone's link is slow."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
