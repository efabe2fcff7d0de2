"""The end of a good write: the plan's commands, session settings back, a last look at every parameter."""

from __future__ import annotations

from functools import partial

from mavcal.calib.firmware.plan import Value
from mavcal.service.jobs.crashpoints import At
from mavcal.service.jobs.journal import JournalStep, Sent, same
from mavcal.service.jobs.write import Writing, check_in_place, current_values


async def finish(w: Writing) -> dict[str, Value]:
    """Do what is left of a verified write; may be called again after a crash. Returns every parameter as last read.

    Raises
    ------
    WriteStopped, WriteFailed, CommandRefused, ParameterError
    """
    done = w.handle.written()
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


async def _restore(w: Writing, sent: Sent) -> None:
    value = await w.get(sent.name)
    if same(value, sent.new, sent.kind) and not same(sent.new, sent.old, sent.kind):
        await w.handle.record(JournalStep.RESTORE, name=sent.name)
        w.reach(At.BEFORE_RESTORE)
        value = await w.set(sent.name, sent.old, sent.kind, instead_of=sent.new)
    await w.handle.record(JournalStep.RESTORED, name=sent.name, value=value)
