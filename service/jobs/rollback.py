"""Taking a write back: in reverse order, only what still holds our value, and verified."""

from __future__ import annotations

from functools import partial

from calib.firmware.plan import Value
from service.errors import WriteFailed
from service.jobs.crashpoints import At
from service.jobs.journal import Sent, Step, holds, same
from service.jobs.write import Writing, read_values


async def roll_back(w: Writing) -> None:
    """Put the old values back. The job is rolling_back; may be called again after a crash.

    Journal rows are best effort here: if the disk is full the vehicle comes first, and recovery reads the vehicle.

    Raises
    ------
    WriteStopped, ParameterError, WriteFailed
        If a parameter may still hold our value.
    """
    w.reach(At.ROLLBACK_BEGUN)
    sent = w.handle.written().sent
    for parameter in reversed(sent):
        await _undo(w, parameter)
    if sent:
        # A PARAM_SET from before the stop may still be under way, and the vehicle has to save.
        await w.settle()
        await _verify(w, sent)


async def _undo(w: Writing, sent: Sent) -> None:
    """Put one old value back if ours is still there."""
    value = await w.get(sent.name)
    if same(value, sent.old, sent.kind):
        await w.handle.record_anyway(Step.UNDONE, name=sent.name, value=value)
        return
    if not same(value, sent.new, sent.kind):
        await _leave(w, sent, value)
        return
    await w.handle.record_anyway(Step.UNDO, name=sent.name)
    w.reach(At.BEFORE_UNDO)
    value = await w.set(sent.name, sent.old, sent.kind)
    w.reach(At.AFTER_UNDO)
    await w.handle.record_anyway(Step.UNDONE, name=sent.name, value=value)


async def _leave(w: Writing, sent: Sent, value: Value) -> None:
    await w.handle.record_anyway(Step.LEFT, name=sent.name, value=value)
    w.handle.warn(f"{sent.name} holds {value:.9g}, which is neither its old value nor ours: it is left so")


async def _verify(w: Writing, sent: tuple[Sent, ...]) -> None:
    names = [s.name for s in sent]
    readings = await w.guard.run(partial(read_values, w.vehicle, names))
    values = {name: reading.value for name, reading in readings.items()}
    ours = [s.name for s in sent if holds(s, values, "new") and not holds(s, values, "old")]
    if ours:
        raise WriteFailed(f"these parameters still hold the new value: {', '.join(ours)}")
    for s in sent:
        if not holds(s, values, "old"):
            await _leave(w, s, values[s.name])
