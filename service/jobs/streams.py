"""Message rates of a session: requested, remembered in the journal, put back."""

from __future__ import annotations

from collections.abc import Mapping

from mavcal.service.errors import ServiceError
from mavcal.service.jobs.handle import JobHandle, waiting
from mavcal.service.jobs.journal import JournalStep
from mavcal.service.jobs.port import JobVehicle

ASKING_S = 1.0
"""About how long it takes to ask for messages and to hear that they are granted."""


async def ask_for_streams(
    handle: JobHandle, vehicle: JobVehicle, rates: Mapping[int, float], *, measure_s: float = 0.0
) -> None:
    """Have messages sent at `rates` (Hz by message id).

    What was before is in the journal before anything is changed. Raises VehicleError, LinkError.
    """
    known = handle.written().intervals
    measured = ", and measuring what the link carries" if measure_s > 0 else ""
    async with waiting(handle, f"starting the sensor streams{measured}", measure_s + ASKING_S):
        before = await vehicle.intervals([message for message in rates if message not in known])
        if before:
            await handle.record(JournalStep.STREAMS, intervals={str(k): v for k, v in before.items()})
        warnings = await vehicle.request_streams(rates, measure_s=measure_s, before={**known, **before})
    for warning in warnings:
        handle.warn(warning)


async def restore_streams(handle: JobHandle, vehicle: JobVehicle) -> None:
    """Put the message rates back that the journal remembers; one that fails is a warning, and is tried again later."""
    intervals = handle.written().intervals
    if not intervals:
        return
    try:
        await vehicle.set_intervals(intervals)
    except ServiceError as error:
        handle.warn(f"the message rates could not be put back yet: {error}")
        return
    await handle.record_anyway(JournalStep.STREAMS_RESTORED)
