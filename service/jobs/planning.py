"""From fits to a plan, and the snapshot that the plan is bound to."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from calib.firmware.compose import compose
from calib.firmware.fingerprint import calibration_snapshot, fingerprint
from calib.firmware.plan import Value, WritePlan, snapshot_sha256
from calib.fit import FitResult
from calib.recording import Identity
from calib.report import plan_to_json
from service.jobs.handle import JobHandle
from service.store.rows import SnapshotPurpose


@dataclasses.dataclass(frozen=True)
class Planned:
    """A plan, and the parameters that it rests on."""

    plan: WritePlan
    composed_on: dict[str, Value]


def make_plan(results: Sequence[FitResult], parameters: Mapping[str, Value], identity: Identity) -> Planned:
    """Compose what to write. Raises FirmwareError if the firmware cannot take it at all."""
    plan = compose(results, parameters, fingerprint(identity, parameters))
    return Planned(plan, calibration_snapshot(parameters))


def keep_plan(handle: JobHandle, planned: Planned) -> None:
    """Bring plan and snapshot onto the disk. Raises DiskFull."""
    plan = planned.plan
    handle.store.add_snapshot(
        handle.id,
        handle.now(),
        SnapshotPurpose.COMPOSED_ON,
        snapshot_sha256(planned.composed_on),
        planned.composed_on,
    )
    handle.store.add_plan(handle.id, plan.sha256, handle.now(), plan_to_json(plan))


def identity_to_json(identity: Identity) -> dict[str, Any]:
    """As plain data, for a job's context."""
    return dataclasses.asdict(identity)


def identity_from_json(data: Mapping[str, Any]) -> Identity:
    """The inverse of :func:`identity_to_json`."""
    firmware = data["firmware"]
    return Identity(**{**data, "firmware": None if firmware is None else tuple(firmware)})
