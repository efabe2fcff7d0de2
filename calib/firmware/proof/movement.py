"""Which movement would prove what the physical check left open."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.plan import Movement, ParameterVerdict, ProofVerdict
from mavcal.calib.firmware.proof.check import ALL_APPLIED, StreamCheck
from mavcal.calib.firmware.proof.evidence import StillMean
from mavcal.calib.recording import Sensor

Array = NDArray[np.float64]

WORTH: Final = 5.0
"""Standard deviations that a movement must promise before an operator is sent to make it."""

NEAR: Final = 0.97
"""Cosine up to which a pose counts as a face (14 deg)."""

FACES: Final = (
    ("level", "upright", (0.0, 0.0, -1.0)),
    ("back", "upside down", (0.0, 0.0, 1.0)),
    ("left", "on its left side", (0.0, 1.0, 0.0)),
    ("right", "on its right side", (0.0, -1.0, 0.0)),
    ("nose_down", "nose down", (-1.0, 0.0, 0.0)),
    ("nose_up", "nose up", (1.0, 0.0, 0.0)),
)
"""Poses by name and in words, with the direction of their specific force in the body (FRD)."""

TEMPERATURE_MARGIN: Final = 0.1
"""Share of the calibrated range that a wished temperature stays inside of it."""
NEAR_ENOUGH: Final = 0.12
"""Share of the calibrated range within which another temperature would say nothing new."""


def movement_for(verdicts: Sequence[ParameterVerdict], checks: Mapping[Subject, StreamCheck]) -> Movement | None:
    """What an operator can do about the parameters that are still open; None if nothing, or if none is."""
    settled = (ProofVerdict.PROVED, ProofVerdict.CONTRADICTED)
    open_ones = {v.name for v in verdicts if v.acts_on_stream and v.verdict not in settled}
    seen = {name for check in checks.values() for name in check.names}
    faces: dict[str, None] = {}
    turn, temperature = False, None
    for about, check in checks.items():
        names = [n for n in check.names if n in open_ones]
        if not names:
            continue
        temperature = _wished_temperature(check, names) if temperature is None else temperature
        if check.capture.expected is None:
            continue
        if about.sensor == Sensor.ACCEL:
            _choose_faces(check, names, faces)
        elif about.sensor == Sensor.MAG:
            turn = turn or _worth_turning(check, names)
    return _in_words(tuple(faces), still=bool(open_ones - seen), turn=turn, temperature=temperature)


def _in_words(faces: tuple[str, ...], *, still: bool, turn: bool, temperature: float | None) -> Movement | None:
    words = {face: text for face, text, _ in FACES}
    wishes = ["hold the vehicle still for five seconds"] if still else []
    if turn:
        wishes.append("turn the vehicle slowly through all directions")
    if faces:
        wishes.append("hold it still " + ", then ".join(words[face] for face in faces))
    if temperature is not None:
        wishes.append(f"leave it alone until its sensors are at about {temperature:.0f} degC")
    if not wishes:
        return None
    text = "; ".join(wishes)
    return Movement(text[:1].upper() + text[1:], faces, turn, temperature)


def _wished_temperature(check: StreamCheck, names: Sequence[str]) -> float | None:
    """The end of the calibrated range that is farther from what was read; None if temperature would not help."""
    whole = check.corrections.model(ALL_APPLIED).polynomial
    if whole is None or not any(_thermal(check, name) for name in names):
        return None
    low, high = whole.t_min, whole.t_max
    read = [r.temperature for r in check.capture.after if r.temperature is not None]
    margin = TEMPERATURE_MARGIN * (high - low)
    ends = (low + margin, high - margin)
    apart = [min((abs(end - t) for t in read), default=high - low) for end in ends]
    best = max(range(2), key=lambda k: apart[k])
    return ends[best] if apart[best] > NEAR_ENOUGH * (high - low) else None


def _thermal(check: StreamCheck, name: str) -> bool:
    """Whether the effect of `name` depends on temperature."""
    with_it, without = (check.corrections.model(h).polynomial for h in (ALL_APPLIED, check.without(name)))
    if with_it is None or without is None:
        return with_it is not without
    heat = np.array([with_it.t_min, 0.5 * (with_it.t_min + with_it.t_max), with_it.t_max])
    return bool(np.ptp(with_it(heat) - without(heat), axis=0).max() > 0.0)


def _choose_faces(check: StreamCheck, names: Sequence[str], faces: dict[str, None]) -> None:
    """Add to `faces` one pose that shows each of `names`, unless one that is in it already does."""
    shown = [_face_of(reading) for reading in check.capture.after]
    readings = {label: _reading(check, np.array(force)) for label, _, force in FACES if label not in shown}
    for name in names:
        promise = {label: check.distance_in(name, (reading,)) for label, reading in readings.items()}
        if not promise or any(promise.get(label, 0.0) >= WORTH for label in faces):
            continue
        best = max(promise, key=lambda label: promise[label])
        if promise[best] >= WORTH:
            faces[best] = None


def _face_of(reading: StillMean) -> str | None:
    """The face that a reading shows; None: it is oblique."""
    direction = reading.mean / max(float(np.linalg.norm(reading.mean)), float(np.finfo(np.float64).tiny))
    label, _, force = max(FACES, key=lambda face: float(direction @ np.array(face[2])))
    return label if float(direction @ np.array(force)) > NEAR else None


def _worth_turning(check: StreamCheck, names: Sequence[str]) -> bool:
    corners = [np.array(c) for c in np.ndindex(3, 3, 3) if c != (1, 1, 1)]
    turn = tuple(_reading(check, (c - 1.0) / np.linalg.norm(c - 1.0)) for c in corners)
    return any(check.distance_in(name, turn) >= WORTH for name in names)


def _reading(check: StreamCheck, direction: Array) -> StillMean:
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
    mean = model.apply(raw, now.temperature)
    return StillMean(now.t, mean, now.covariance, now.temperature, now.current, now.throttle)
