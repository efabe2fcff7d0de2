"""Which of PX4's calibration vectors reach the memory that corrects, and in which order they must be written.

A vector replaces the one in memory only if it differs by more than a threshold (FLIGHT_CONTROLLERS 1.4, 10). Two
questions follow. *After a restart*, memory starts from the neutral vector. A vector within the threshold of neutral
never comes into force, so neutral is written and the difference announced as a loss. *Now*, every single PARAM_SET
loads the vector as it then is. The components are written in an order that ends with all of them in memory. Without
such an order, the change takes effect with a restart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from mavcal.calib.firmware import names
from mavcal.calib.firmware.compose.draft import Draft, Rank, Subject
from mavcal.calib.firmware.names import Role, Triple
from mavcal.calib.firmware.plan import Value
from mavcal.calib.firmware.px4 import parameters as px4
from mavcal.calib.firmware.slots import NO_DEVICE_IDS, px4_instance, px4_slot
from mavcal.calib.fit import AXES
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.triad import TriadModel

NEUTRAL: Mapping[Triple, float] = {names.OFFSET: 0.0, names.SCALE: 1.0, names.CROSS: 0.0}
NOISE = 7.815
"""95 % quantile of chi-squared with three degrees of freedom: below it a vector's change is within its uncertainty."""
RANK: Mapping[Triple, Rank] = {names.OFFSET: Rank.OFFSET, names.SCALE: Rank.SCALE, names.CROSS: Rank.CROSS}


@dataclass(frozen=True, eq=False)
class Vector:
    """A vector that is wanted in one row of PX4's calibration, with its uncertainty, in parameter units."""

    about: Subject
    triple: Triple
    values: Array
    sd: Array
    unit: str
    why: str


def placed(draft: Draft, about: Subject, parameters: Mapping[str, Value]) -> Subject:
    """The sensor that corrects with the row of `about`, which may be another one since PX4 assigns rows by order.

    A planned id changes the order of the filled rows. A magnetometer has the row of its stated device id, because its
    stream is raw; the fits of others contain the correction undone by order.
    """
    device_ids = draft.options.device_ids if about.sensor == Sensor.MAG else NO_DEVICE_IDS
    slot = px4_slot(draft.parameters, about.sensor, about.instance, device_ids)
    return Subject(about.sensor, px4_instance(parameters, about.sensor, slot))


def row_of(draft: Draft, about: Subject) -> Mapping[Role, str]:
    """Names by role of the parameters that correct `about`; the thermal row is that of the id that will be there."""
    after = draft.predicted
    return px4.calibration_names(after, about.sensor, placed(draft, about, after).instance)


def held_by(draft: Draft, about: Subject) -> px4.Px4Calibration:
    """The calibration that PX4 applies to `about` after a restart."""
    here = placed(draft, about, draft.parameters)
    return px4.Px4Calibration.load(draft.parameters, about.sensor, here.instance)


def model_after(draft: Draft, about: Subject) -> TriadModel:
    """As :func:`neutral_model`, with the parameters of the draft."""
    after = draft.predicted
    return neutral_model(after, placed(draft, about, after))


def neutral_model(parameters: Mapping[str, Value], about: Subject) -> TriadModel:
    """The correction of `about` without its ``CAL_*`` row: thermal term and mounting."""
    return px4.calibration_in_force(
        parameters, about.sensor, about.instance, px4.Px4Calibration(about.sensor, about.instance)
    )


def survives_restart(about: Subject, triple: Triple, values: Array) -> bool:
    """Whether PX4 applies the stored `values` (3,) after a boot; vectors below its threshold it ignores."""
    if about.sensor == Sensor.GYRO and triple == names.OFFSET:
        return True  # the threshold is waived for the first load
    limits = px4.THRESHOLDS[about.sensor]
    limit = {names.OFFSET: limits.offset, names.SCALE: limits.scale, names.CROSS: limits.cross}[triple]
    difference = values.astype(np.float32) - np.float32(NEUTRAL[triple])
    return bool(np.dot(difference, difference) > np.float32(limit) ** 2)


def representable(vector: Vector) -> Array:
    """Values in effect after a restart with `values` stored: these, or the neutral vector."""
    if survives_restart(vector.about, vector.triple, vector.values):
        return _single(vector.values)
    return np.full(3, NEUTRAL[vector.triple])


def order_without_restart(draft: Draft, vector: Vector, values: Array) -> tuple[int, ...] | None:
    """An order of the axes in which writing `values` brings them into memory; None: only a restart does."""
    roles = row_of(draft, vector.about)
    if int(draft.parameters.get(roles[Role.ID], 0)) == 0:
        return (0, 1, 2)  # an empty row is loaded from neutral when its id is written, which comes last
    axes = [i for i in range(3) if np.float32(draft.get(roles[vector.triple[i]], np.nan)) != np.float32(values[i])]
    memory = held_by(draft, vector.about)
    for order in permutations(axes):
        after = _write(memory, draft, roles, vector, values, order)
        held = {names.OFFSET: after.offset, names.SCALE: after.scale, names.CROSS: after.cross}[vector.triple]
        if np.array_equal(_single(held), _single(values)):
            return order
    return None


def set_vector(draft: Draft, vector: Vector, values: Array) -> None:
    """Plan `values` (what :func:`representable` leaves of the wanted ones) in an order that works at once, if any."""
    roles = row_of(draft, vector.about)
    order = order_without_restart(draft, vector, values)
    if order is None and _is_noise(draft, roles, vector, values):
        return  # beside other changes of this sensor: a restart for it would be for nothing
    estimated = np.array_equal(values, _single(vector.values))
    for axis in range(3):
        why = f"{vector.why}, {AXES[axis]} axis" if vector.triple != names.CROSS else vector.why
        draft.set_real(
            roles[vector.triple[axis]],
            float(values[axis]),
            RANK[vector.triple],
            why if order is not None else f"{why}; too small a change for PX4's memory, it acts after a restart",
            about=vector.about,
            sd=(float(vector.sd[axis]) or None) if estimated else None,
            unit=vector.unit,
            needs_reboot=order is None,
        )
    if order is not None:
        draft.reorder([roles[vector.triple[axis]] for axis in order])


def _is_noise(draft: Draft, roles: Mapping[Role, str], vector: Vector, values: Array) -> bool:
    """Whether the vector in force lies within the 95 % region of the wanted one, its axes taken as independent."""
    held = np.array([float(draft.parameters.get(roles[role], np.nan)) for role in vector.triple])
    if not (np.isfinite(held).all() and (vector.sd > 0.0).all()):
        return False
    return float((((values - held) / vector.sd) ** 2).sum()) <= NOISE


def _single(values: Array) -> Array:
    """`values` as a vehicle holds them."""
    return values.astype(np.float32).astype(np.float64)


def _write(
    memory: px4.Px4Calibration,
    draft: Draft,
    roles: Mapping[Role, str],
    vector: Vector,
    values: Array,
    order: Sequence[int],
) -> px4.Px4Calibration:
    stored = dict(draft.parameters)
    for axis in order:
        stored[roles[vector.triple[axis]]] = float(np.float32(values[axis]))
        memory = memory.update(stored)
    return memory
