"""Which movement would prove what the physical check left open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from calib.firmware.check import ALL_APPLIED, StreamCheck
from calib.firmware.draft import Subject
from calib.firmware.evidence import Reading
from calib.firmware.plan import ParameterVerdict, Verdict
from calib.recording import Sensor

Array = NDArray[np.float64]

WORTH: Final = 5.0
"""Standard deviations that a movement must promise before an operator is sent to make it."""

NEAR: Final = 0.97
"""Cosine up to which a pose counts as a face (14 deg)."""

FACES: Final = (
    ("upright", (0.0, 0.0, -1.0)),
    ("upside down", (0.0, 0.0, 1.0)),
    ("on its left side", (0.0, 1.0, 0.0)),
    ("on its right side", (0.0, -1.0, 0.0)),
    ("nose down", (-1.0, 0.0, 0.0)),
    ("nose up", (1.0, 0.0, 0.0)),
)
"""Poses with the direction of their specific force in the body (FRD)."""


def movement_for(verdicts: Sequence[ParameterVerdict], checks: Mapping[Subject, StreamCheck]) -> str | None:
    """One sentence for the operator; None if everything is proved, or no movement would help."""
    open_ones = {
        v.name for v in verdicts if v.acts_on_stream and v.verdict not in (Verdict.PROVED, Verdict.CONTRADICTED)
    }
    seen = {name for check in checks.values() for name in check.names}
    wishes = ["hold the vehicle still for five seconds"] if open_ones - seen else []
    faces: dict[str, None] = {}
    for about, check in checks.items():
        names = [n for n in check.names if n in open_ones]
        if not names or check.capture.expected is None:
            continue
        if about.sensor == Sensor.ACCEL:
            _choose_faces(check, names, faces)
        elif about.sensor == Sensor.MAG and _worth_turning(check, names):
            wishes.append("turn the vehicle slowly through all directions")
    if faces:
        wishes.append("hold it still " + ", then ".join(faces))
    text = "; ".join(dict.fromkeys(wishes))
    return text[:1].upper() + text[1:] if text else None


def _choose_faces(check: StreamCheck, names: Sequence[str], faces: dict[str, None]) -> None:
    """Add to `faces` one pose that shows each of `names`, unless one that is in it already does."""
    shown = [_face_of(reading) for reading in check.capture.after]
    readings = {label: _reading(check, np.array(force)) for label, force in FACES if label not in shown}
    for name in names:
        promise = {label: check.distance_in(name, (reading,)) for label, reading in readings.items()}
        if not promise or any(promise.get(label, 0.0) >= WORTH for label in faces):
            continue
        best = max(promise, key=lambda label: promise[label])
        if promise[best] >= WORTH:
            faces[best] = None


def _face_of(reading: Reading) -> str | None:
    """The face that a reading shows; None: it is oblique."""
    direction = reading.mean / np.linalg.norm(reading.mean)
    label, force = max(FACES, key=lambda face: float(direction @ np.array(face[1])))
    return label if float(direction @ np.array(force)) > NEAR else None


def _worth_turning(check: StreamCheck, names: Sequence[str]) -> bool:
    corners = [np.array(c) for c in np.ndindex(3, 3, 3) if c != (1, 1, 1)]
    turn = tuple(_reading(check, (c - 1.0) / np.linalg.norm(c - 1.0)) for c in corners)
    return any(check.distance_in(name, turn) >= WORTH for name in names)


def _reading(check: StreamCheck, direction: Array) -> Reading:
    """What would be streamed of a true vector along `direction` in the body, as precisely as now."""
    capture = check.capture
    now = (*capture.after, *capture.invariant)[0]
    model = check.corrections.model(ALL_APPLIED)
    expected = capture.expected
    assert expected is not None
    size = expected.magnitude or float(np.linalg.norm(now.mean))
    raw = model.invert(size * direction, now.temperature)
    # the true reading is the one that the fitted model makes as long as it should be
    corrected = expected.model.apply(raw, now.temperature)
    raw = expected.model.invert(corrected * size / np.linalg.norm(corrected), now.temperature)
    return Reading(now.t, model.apply(raw, now.temperature), now.covariance, now.temperature, now.current, now.throttle)
