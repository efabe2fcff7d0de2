"""From fits to a plan, and the snapshot that the plan is bound to."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from calib.errors import InvalidInputError
from calib.firmware.compose import ComposeOptions, compose
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


PLAN_OPTIONS = tuple(f.name for f in dataclasses.fields(ComposeOptions) if f.type == "bool")
"""What the operator may decide about a plan, each true or false."""


def checked_plan_options(options: Mapping[str, Any]) -> dict[str, bool]:
    """`options` if every one is known and a switch. Raises InvalidInputError."""
    for name, value in options.items():
        if name not in PLAN_OPTIONS:
            raise InvalidInputError(f"a plan has no option {name}; its options are: {', '.join(PLAN_OPTIONS)}")
        if not isinstance(value, bool):
            raise InvalidInputError(f"option {name} of a plan is a switch: give true or false, not {value!r}")
    return dict(options)


def _compose_options(switches: Mapping[str, bool]) -> ComposeOptions:
    chosen: dict[str, Any] = dict(switches)
    return ComposeOptions(**chosen)


def make_plan(
    results: Sequence[FitResult],
    parameters: Mapping[str, Value],
    identity: Identity,
    options: Mapping[str, bool],
) -> Planned:
    """Compose what to write. Raises FirmwareError if the firmware cannot take it at all."""
    plan = compose(results, parameters, fingerprint(identity, parameters), options=_compose_options(options))
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
