"""Restarts the vehicle in the middle of a write, by our command or by the operator's hand."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial

from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.service.errors import CommandRefused, CommandTimeout, WriteFailed, WriteStopped
from mavcal.service.jobs.crashpoints import At
from mavcal.service.jobs.guard import STOPPING
from mavcal.service.jobs.handle import waiting
from mavcal.service.jobs.journal import JournalStep
from mavcal.service.jobs.write import Writing

PREFLIGHT_REBOOT_SHUTDOWN = 246
REBOOT_AUTOPILOT = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

ASK = Prompt(PromptStep.REBOOT, "Restart the vehicle: switch it off and on again. The new values act only then.")


async def restart(w: Writing) -> None:
    """Have the vehicle restarted and wait until it may be written to again.

    Everything must have been read back, and hence saved, before. The vehicle is restarted by us only if the operator
    accepted that; otherwise the operator is asked.

    Raises
    ------
    WriteStopped
        If it does not come back in time: its values are not known then.
    WriteFailed
        If another vehicle comes back.
    """
    before = w.vehicle.condition().reboots
    if w.accept.reboot and await _commanded(w):
        limit = w.settings.reboot_timeout_s
    else:
        w.handle.prompt(ASK)
        limit = w.settings.operator_reboot_s
    async with waiting(w.handle, f"waiting for the vehicle to restart, for at most {limit:.0f} s", limit_s=limit):
        await _back_again(w, before, limit)
        w.handle.prompt(None)
        w.guard.expect_restart()
        identity = await w.guard.run(w.vehicle.identify)
    if identity.uid is not None and identity.uid != (w.plan.fingerprint.uid or None):
        raise WriteFailed("another vehicle came back after the restart")
    await w.handle.record(JournalStep.REBOOTED)
    w.reach(At.REBOOTED)


async def _commanded(w: Writing) -> bool:
    """Tell the vehicle to restart; False if it refuses."""
    await w.handle.record(JournalStep.REBOOT)
    w.reach(At.REBOOT_SENT)
    try:
        # A vehicle that restarts at once acknowledges nothing; whether it did is seen later.
        with suppress(CommandTimeout, *STOPPING):
            await w.guard.run(partial(w.vehicle.command, PREFLIGHT_REBOOT_SHUTDOWN, REBOOT_AUTOPILOT))
    except CommandRefused as refusal:
        w.handle.warn(f"the vehicle refused to restart by itself: {refusal}")
        return False
    return True


async def _back_again(w: Writing, before: int, limit: float) -> None:
    """Wait until the vehicle has restarted, is heard, disarmed and on the ground."""
    loop = asyncio.get_running_loop()
    deadline = loop.time() + limit
    while True:
        late = loop.time() >= deadline  # looked at before the vehicle: a late event loop looks once more
        now = w.vehicle.condition()
        if now.armed and not now.silent:
            raise WriteStopped("the vehicle was armed while it should restart")
        if now.reboots != before and not now.silent and not now.obstacles:
            return
        if late:
            raise WriteStopped(f"the vehicle did not restart within {limit:.0f} s")
        await asyncio.sleep(w.settings.watch_s)
