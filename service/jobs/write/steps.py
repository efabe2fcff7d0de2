"""The steps of a write: snapshot, one parameter after the other, read-back, restart, finish, roll back.

Everything that is sent is announced in the journal before and confirmed after. A crash at any instant therefore leaves
enough to finish or to roll back (:mod:`service.jobs.write.steps.transaction`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Mapping
from contextlib import suppress
from functools import partial

from mavcal.calib.firmware.in_force.fingerprint import fingerprint, matters
from mavcal.calib.firmware.plan import Change, Value, snapshot_sha256
from mavcal.calib.firmware.values import shown
from mavcal.calib.procedures.protocol import Prompt, PromptStep
from mavcal.service.errors import (
    CommandRefused,
    CommandTimeout,
    ParameterMissing,
    PlanBlocked,
    PlanChanged,
    WriteFailed,
    WriteStopped,
)
from mavcal.service.jobs.core.crashpoints import At
from mavcal.service.jobs.core.handle import counting, waiting
from mavcal.service.jobs.core.journal import JournalStep, Sent, same
from mavcal.service.jobs.write.context import Settling, WriteContext
from mavcal.service.jobs.write.guard import STOPPING
from mavcal.service.store.rows import SnapshotPurpose
from mavcal.service.vehicle.job_vehicle import ParameterReading, read_values


async def check_plan(w: WriteContext) -> dict[str, ParameterReading]:
    """Make sure that the plan still fits the vehicle; returns fresh readings of everything that it rests on.

    Raises
    ------
    PlanBlocked, PlanChanged
        With what is in the way, or what differs.
    """
    if w.plan.blockers:
        raise PlanBlocked("the plan may not be written: " + "; ".join(w.plan.blockers))
    composed_on = w.composed_on()
    identity = await w.vehicle.identify()
    try:
        names = list(dict.fromkeys([*composed_on, *(change.name for change in w.plan.changes)]))
        progress = counting(w.handle, "reading what the plan rests on")
        fresh = await read_values(w.vehicle, names, progress=lambda done: progress(done, len(names)))
    except ParameterMissing as error:
        raise PlanChanged(f"the vehicle no longer has {error.name}: plan again") from error
    now = {name: fresh[name].value for name in composed_on if matters(name, w.plan.sensors)}
    differing = [f"{n} was {shown(composed_on[n])} and is {shown(v)}" for n, v in now.items() if v != composed_on[n]]
    if differing:
        raise PlanChanged(f"parameters changed since the plan was made: {', '.join(differing)}. Plan again")
    if snapshot_sha256(now) != w.plan.snapshot_sha256 or fingerprint(identity, now) != w.plan.fingerprint:
        raise PlanChanged
    kinds = [(change, fresh[change.name].kind) for change in w.plan.changes]
    wrong = [f"{change.name} is {kind}, not {change.kind}" for change, kind in kinds if kind != change.kind]
    if wrong:
        raise PlanChanged(f"the vehicle's types are not those of the plan: {', '.join(wrong)}. Plan again")
    return fresh


async def prepare(w: WriteContext) -> None:
    """Check the plan against the vehicle and keep the old values. Nothing is sent yet.

    Raises
    ------
    PlanBlocked, PlanChanged, WriteStopped
    """
    fresh = await w.guard.run(partial(check_plan, w))
    old = {change.name: fresh[change.name] for change in w.plan.changes}
    body = {name: {"value": reading.value, "kind": reading.kind.value} for name, reading in old.items()}
    digest = snapshot_sha256({name: reading.value for name, reading in old.items()})
    at, store = w.handle.now(), w.handle.store
    await store.do(lambda: store.add_snapshot(w.handle.id, at, SnapshotPurpose.BEFORE_WRITE, digest, body))
    await w.handle.record(JournalStep.SNAPSHOT, sha256=digest)
    w.reach(At.SNAPSHOT_KEPT)


async def send_all(w: WriteContext) -> None:
    """Write every parameter of the plan in its order. Raises WriteStopped, ParameterError."""
    before = w.old_values()
    progress = counting(w.handle, "writing")
    for number, change in enumerate(w.plan.changes):
        w.guard.check()
        progress(number, len(w.plan.changes))
        old = before[change.name]
        await w.handle.record(
            JournalStep.SEND, name=change.name, old=old, new=change.new, kind=change.kind.value, session=change.session
        )
        w.reach(At.BEFORE_SEND)
        value = await w.set(change.name, change.new, change.kind, instead_of=old)
        w.reach(At.AFTER_ECHO)
        await w.handle.record(JournalStep.ECHO, name=change.name, value=value)
        w.reach(At.ECHO_KEPT)
    progress(len(w.plan.changes), len(w.plan.changes))


async def read_back(w: WriteContext, until: Settling = Settling.KEPT) -> dict[str, Value]:
    """Wait until the vehicle has settled, then read every parameter.

    Raises
    ------
    WriteFailed
        Naming every parameter that does not hold its new value.
    """
    await w.settle(until)
    values = await current_values(w)
    check_in_place(w.plan.changes, values)
    await w.handle.record(JournalStep.READ_BACK, at=w.handle.now(), boot_time=w.vehicle.condition().boot_time)
    w.reach(At.READ_BACK)
    return values


async def current_values(w: WriteContext) -> dict[str, Value]:
    """Fresh values of the plan's parameters, under the guard."""
    names = [change.name for change in w.plan.changes]
    progress = counting(w.handle, "reading back")
    readings = await w.guard.run(
        partial(read_values, w.vehicle, names, progress=lambda done: progress(done, len(names)))
    )
    return {name: reading.value for name, reading in readings.items()}


def check_in_place(changes: Iterable[Change], values: Mapping[str, Value]) -> None:
    """Raise WriteFailed naming every change whose new value is not among `values`."""
    wrong = [
        f"{c.name} holds {shown(values[c.name])} instead of {shown(c.new)}"
        for c in changes
        if not same(values[c.name], c.new, c.kind)
    ]
    if wrong:
        raise WriteFailed(f"the read-back differs: {', '.join(wrong)}")


PREFLIGHT_REBOOT_SHUTDOWN = 246
REBOOT_AUTOPILOT = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
ASK_TO_RESTART = Prompt(
    PromptStep.REBOOT, "Restart the vehicle: switch it off and on again. The new values act only then."
)


async def restart(w: WriteContext) -> None:
    """Restart the vehicle, or ask for it, and wait until it may be written to again.

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
    if w.accept.reboot and await _command_restart(w):
        limit = w.settings.reboot_timeout_s
    else:
        w.handle.prompt(ASK_TO_RESTART)
        limit = w.settings.operator_reboot_s
    async with waiting(w.handle, f"waiting for the vehicle to restart, for at most {limit:.0f} s", limit_s=limit):
        await _until_restarted(w, before, limit)
        w.handle.prompt(None)
        w.guard.expect_restart()
        identity = await w.guard.run(w.vehicle.identify)
    if identity.uid is not None and identity.uid != (w.plan.fingerprint.uid or None):
        raise WriteFailed("another vehicle came back after the restart")
    await w.handle.record(JournalStep.REBOOTED)
    w.reach(At.REBOOTED)


async def _command_restart(w: WriteContext) -> bool:
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


async def _until_restarted(w: WriteContext, before: int, limit: float) -> None:
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


async def finish(w: WriteContext) -> dict[str, Value]:
    """Finish a verified write; may be called again after a crash. Returns every parameter as last read.

    Raises
    ------
    WriteStopped, WriteFailed, CommandRefused, ParameterError
    """
    done = w.handle.write_record()
    for index, after in enumerate(w.plan.after):
        if index not in done.commanded:
            await w.handle.record(JournalStep.COMMAND, index=index, command=after.command)
            w.reach(At.BEFORE_COMMAND)
            await w.guard.run(partial(w.vehicle.command, after.command, after.params))
            w.reach(At.AFTER_COMMAND)
            await w.handle.record(JournalStep.COMMANDED, index=index)
    for sent in reversed(done.sent):
        if sent.session and sent.name not in done.restored:
            await _restore(w, sent)
    values = await current_values(w)
    check_in_place((change for change in w.plan.changes if not change.session), values)
    return values


async def _restore(w: WriteContext, sent: Sent) -> None:
    value = await w.get(sent.name)
    if same(value, sent.new, sent.kind) and not same(sent.new, sent.old, sent.kind):
        await w.handle.record(JournalStep.RESTORE, name=sent.name)
        w.reach(At.BEFORE_RESTORE)
        value = await w.set(sent.name, sent.old, sent.kind, instead_of=sent.new)
    await w.handle.record(JournalStep.RESTORED, name=sent.name, value=value)


async def roll_back(w: WriteContext) -> dict[str, Value]:
    """Put the old values back; returns every parameter of the plan as it was read afterwards.

    The job is rolling_back; may be called again after a crash. Journal rows are best effort here: if the disk is full
    the vehicle comes first, and recovery reads the vehicle.

    Raises
    ------
    WriteStopped, ParameterError, WriteFailed
    """
    w.reach(At.ROLLBACK_BEGUN)
    for parameter in reversed(w.handle.write_record().sent):
        await _undo(w, parameter)
    # A PARAM_SET from before the stop may still be under way, and the vehicle has to save.
    await w.settle()
    return await current_values(w)


async def _undo(w: WriteContext, sent: Sent) -> None:
    """Put one old value back if ours is still there."""
    value = await w.get(sent.name)
    if same(value, sent.old, sent.kind):
        await w.handle.record_anyway(JournalStep.UNDONE, name=sent.name, value=value)
        return
    if not same(value, sent.new, sent.kind):
        await w.confirm_identity()
        await w.handle.record_anyway(JournalStep.LEFT, name=sent.name, value=value)
        return
    await w.handle.record_anyway(JournalStep.UNDO, name=sent.name)
    w.reach(At.BEFORE_UNDO)
    value = await w.set(sent.name, sent.old, sent.kind, instead_of=sent.new)
    w.reach(At.AFTER_UNDO)
    await w.handle.record_anyway(JournalStep.UNDONE, name=sent.name, value=value)
