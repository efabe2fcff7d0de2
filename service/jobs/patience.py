"""Waits for a vehicle that calibrates itself, for example just after its start: for a limited time, and visibly."""

from __future__ import annotations

import asyncio

from mavcal.calib.procedures.protocol import Progress, Prompt, PromptStep
from mavcal.service.errors import VehicleBusy
from mavcal.service.jobs.handle import JobHandle
from mavcal.service.jobs.port import JobVehicle
from mavcal.service.jobs.settings import JobSettings


async def until_idle(handle: JobHandle, vehicle: JobVehicle, settings: JobSettings) -> None:
    """Wait until the vehicle runs no calibration of its own; what else stands in the way is the caller's.

    Raises
    ------
    VehicleBusy
        If it still does after `settings.busy_s`.
    """
    loop = asyncio.get_running_loop()
    begun = loop.time()
    shown = False
    while (busy := _busy(vehicle, settings)) is not None:
        reason, left = busy
        waited = loop.time() - begun
        if waited > settings.busy_s:
            raise VehicleBusy(f"{reason}, and has not ended within {settings.busy_s:.0f} s")
        text = f"Waiting: {reason}. Keep the vehicle still; this waits for at most {settings.busy_s:.0f} s."
        handle.prompt(Prompt(PromptStep.BUSY, text))
        target = settings.busy_s if left is None else waited + left
        handle.progress(Progress(waited, target, "s", reason, eta=left))
        shown = True
        await asyncio.sleep(settings.watch_s)
    if shown:
        handle.prompt(None)


def _busy(vehicle: JobVehicle, settings: JobSettings) -> tuple[str, float | None] | None:
    """What keeps the vehicle, and for how long still where that is known."""
    now = vehicle.condition()
    if now.silent or now.armed or now.conflict is not None:
        return None
    if now.calibrating:
        return "the vehicle runs a calibration of its own", None
    needed = settings.started_s.get(vehicle.identity.autopilot or "", 0.0)
    if now.boot_time is not None and now.boot_time < needed:
        reason = f"the vehicle started less than {needed:.0f} s ago and may calibrate its gyros by itself"
        return reason, needed - now.boot_time
    return None
