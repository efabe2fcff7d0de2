"""What is known of each parameter that a write touched. All functions are pure."""

from __future__ import annotations

from collections.abc import Mapping

from mavcal.calib.firmware.in_force.fingerprint import REWRITTEN_AT_REST
from mavcal.calib.firmware.plan import ParameterKind, Value, WritePlan
from mavcal.service.jobs.core.journal import BY_OPERATOR, WriteRecord, same
from mavcal.service.jobs.core.model import Holds, Standing

SOMEBODY = "somebody else"


EITHER = "the vehicle itself or somebody else"


def holding(value: Value | None, old: Value, new: Value, kind: ParameterKind) -> Holds:
    """Which value a parameter holds; `old` where both are one."""
    if value is None:
        return Holds.UNKNOWN
    if same(value, old, kind):
        return Holds.OLD
    return Holds.NEW if same(value, new, kind) else Holds.OTHER


# --- readings


def as_read(plan: WritePlan, old: Mapping[str, Value], values: Mapping[str, Value], who: str) -> tuple[Standing, ...]:
    """Every parameter of a plan as it was freshly read, `old` being what it held before the write."""
    found = []
    for change in plan.changes:
        name, value, before = change.name, values.get(change.name), old[change.name]
        holds = holding(value, before, change.new, change.kind)
        note = f"set by {who}; it is left so" if holds == Holds.OTHER else ""
        found.append(Standing(name, before, change.new, value, value is not None, note, holds))
    return tuple(found)


def as_heard(record: WriteRecord, heard: Mapping[str, Value], doubt: str | None = None) -> tuple[Standing, ...]:
    """Every parameter that may have been touched, as it was last heard.

    `heard` are values heard since the last PARAM_SET of each name. One that was not also confirmed as the answer to
    that PARAM_SET is no proof: it may be a late echo from before. With a `doubt` nothing is certain, and once a session
    setting was put back the vehicle may calibrate by itself again.
    """
    found = []
    freed = [s.name for s in record.sent if s.session and s.name in record.undone | record.restored]
    for sent in record.sent:
        value = heard.get(sent.name, sent.confirmed)
        confirmed = sent.confirmed is not None and value is not None and same(value, sent.confirmed, sent.kind)
        note = f"set by {who_sets(sent.name)}" if sent.name in record.left else doubt or ""
        if freed and not sent.session and sent.name not in record.left:
            note = "; ".join(filter(None, (note, f"the vehicle may change it since {freed[0]} was put back")))
        certain = confirmed and doubt is None and (sent.session or not freed)
        holds = holding(value, sent.old, sent.new, sent.kind) if certain else Holds.UNKNOWN
        found.append(Standing(sent.name, sent.old, sent.new, value, certain, note, holds))
    return tuple(found)


def who_sets(name: str) -> str:
    """Return who may have changed this parameter while the vehicle ran. PX4 rewrites its gyro offsets at rest."""
    return EITHER if name in REWRITTEN_AT_REST else SOMEBODY


def who_else(record: WriteRecord, plan: WritePlan) -> str:
    """Who may have set a value that is neither old nor new.

    PX4 rewrites its gyro offsets at rest. After a restart the vehicle may have calibrated itself, also once a session
    setting was put back that kept it from that. Nobody listened while the service was away.
    """
    freed = any(s.session and s.name in record.undone | record.restored for s in record.sent)
    later = record.interrupted or record.rolling_back == BY_OPERATOR
    alone = later or record.restarted or record.reboot_announced or record.rebooted
    at_rest = any(change.name in REWRITTEN_AT_REST for change in plan.changes)
    return EITHER if freed or alone or at_rest else SOMEBODY
