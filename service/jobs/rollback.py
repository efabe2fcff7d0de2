"""Taking a write back: in reverse order, only what still holds our value, and verified."""

from __future__ import annotations

from calib.firmware.values import shown
from service.errors import WriteFailed
from service.jobs.crashpoints import At
from service.jobs.journal import Sent, Step, holds, same
from service.jobs.model import Standing
from service.jobs.write import Writing, current_values


async def roll_back(w: Writing) -> tuple[Standing, ...]:
    """Put the old values back; returns the parameters that hold somebody else's value and are left so.

    The job is rolling_back; may be called again after a crash. Journal rows are best effort here: if the disk is full
    the vehicle comes first, and recovery reads the vehicle.

    Raises
    ------
    WriteStopped, ParameterError, WriteFailed
        If a parameter may still hold our value.
    """
    w.reach(At.ROLLBACK_BEGUN)
    sent = w.handle.written().sent
    if not sent:
        return ()
    for parameter in reversed(sent):
        await _undo(w, parameter)
    # A PARAM_SET from before the stop may still be under way, and the vehicle has to save.
    await w.settle()
    return await _verified(w, sent)


async def _undo(w: Writing, sent: Sent) -> None:
    """Put one old value back if ours is still there."""
    value = await w.get(sent.name)
    if same(value, sent.old, sent.kind):
        await w.handle.record_anyway(Step.UNDONE, name=sent.name, value=value)
        return
    if not same(value, sent.new, sent.kind):
        await w.ask_who()
        await w.handle.record_anyway(Step.LEFT, name=sent.name, value=value)
        return
    await w.handle.record_anyway(Step.UNDO, name=sent.name)
    w.reach(At.BEFORE_UNDO)
    value = await w.set(sent.name, sent.old, sent.kind, instead_of=sent.new)
    w.reach(At.AFTER_UNDO)
    await w.handle.record_anyway(Step.UNDONE, name=sent.name, value=value)


async def _verified(w: Writing, sent: tuple[Sent, ...]) -> tuple[Standing, ...]:
    """Read the whole plan's parameters: those that we sent, and those that somebody may have changed meanwhile."""
    values = await current_values(w)
    ours = [s.name for s in sent if holds(s, values, "new") and not holds(s, values, "old")]
    if ours:
        raise WriteFailed(f"these parameters still hold the new value: {', '.join(ours)}")
    left = []
    for change in w.plan.changes:
        old, value = w.old_value(change), values[change.name]
        if not same(value, old, change.kind):
            await w.handle.record_anyway(Step.LEFT, name=change.name, value=value)
            note = f"{change.name} held {shown(old)} before and holds {shown(value)} now, not set by us: it is left so"
            w.handle.warn(note)
            left.append(Standing(change.name, old, change.new, value, certain=True, note=note))
    return tuple(left)
