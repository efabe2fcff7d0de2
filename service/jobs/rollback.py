"""Takes a write back: in reverse order, only parameters that still hold our value, and with a check."""

from __future__ import annotations

from mavcal.calib.firmware.plan import Value
from mavcal.service.jobs.crashpoints import At
from mavcal.service.jobs.journal import JournalStep, Sent, same
from mavcal.service.jobs.write import Writing, current_values


async def roll_back(w: Writing) -> dict[str, Value]:
    """Put the old values back; returns every parameter of the plan as it was read afterwards.

    The job is rolling_back; may be called again after a crash. Journal rows are best effort here: if the disk is full
    the vehicle comes first, and recovery reads the vehicle.

    Raises
    ------
    WriteStopped, ParameterError, WriteFailed
    """
    w.reach(At.ROLLBACK_BEGUN)
    for parameter in reversed(w.handle.written().sent):
        await _undo(w, parameter)
    # A PARAM_SET from before the stop may still be under way, and the vehicle has to save.
    await w.settle()
    return await current_values(w)


async def _undo(w: Writing, sent: Sent) -> None:
    """Put one old value back if ours is still there."""
    value = await w.get(sent.name)
    if same(value, sent.old, sent.kind):
        await w.handle.record_anyway(JournalStep.UNDONE, name=sent.name, value=value)
        return
    if not same(value, sent.new, sent.kind):
        await w.ask_who()
        await w.handle.record_anyway(JournalStep.LEFT, name=sent.name, value=value)
        return
    await w.handle.record_anyway(JournalStep.UNDO, name=sent.name)
    w.reach(At.BEFORE_UNDO)
    value = await w.set(sent.name, sent.old, sent.kind, instead_of=sent.new)
    w.reach(At.AFTER_UNDO)
    await w.handle.record_anyway(JournalStep.UNDONE, name=sent.name, value=value)
