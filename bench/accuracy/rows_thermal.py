"""Temperature, cubic, six channels: error over bound with white noise, honest intervals under a slow wander, time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.accuracy import bounds, scenes
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, run_case
from bench.accuracy.tables import Part, accuracy_part
from bench.rows import Row, Section, beside, best_of
from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.fit import FitStatus
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage
from mavcal.calib.thermal.drift import DriftBlocks
from mavcal.calib.thermal.fit import fit_polynomial

Array = NDArray[np.float64]

T_REF = 35.0
RATE = 50.0
MILLI_G = 1e-3 * STANDARD_GRAVITY
QUANTA = np.array([MILLI_G] * 3 + [1e-3] * 3)
NOISE = np.array([3.0 * MILLI_G] * 3 + [2e-3] * 3)
CUBICS = np.array(  # of accelerometer and gyro, degC^-1 to degC^-3, axis by axis
    [
        [2.1e-3, -3.0e-5, 4.0e-7],
        [-1.4e-3, 2.2e-5, -3.0e-7],
        [3.0e-3, 4.0e-5, 6.0e-7],
        [1.6e-4, -2.0e-6, 3.0e-8],
        [-2.2e-4, 3.0e-6, 5.0e-8],
        [1.1e-4, 1.5e-6, -4.0e-8],
    ]
)
LEVELS = np.array([0.12, -0.08, -9.7, 0.011, -0.006, 0.004])
TARGET = 1.03


@dataclass(frozen=True, eq=False)
class Warmup:
    """Six series (N, 6) of a unit that warms up, and its temperature (N,) to a hundredth of a degree."""

    t: Array
    temperature: Array
    values: Array


def _warmup(rng: np.random.Generator, count: int, walk: float) -> Warmup:
    """`walk`: a slow wander by that many times the noise of a sample, in the course of the recording."""
    phase = np.linspace(0.0, 1.0, count)
    temperature = np.round(22.0 + 40.0 * (1.0 - np.exp(-3.0 * phase)) / (1.0 - np.exp(-3.0)), 2)
    x = temperature - T_REF
    values = LEVELS + np.column_stack([x, x * x, x**3]) @ CUBICS.T
    values += NOISE * rng.normal(size=values.shape)
    if walk:
        for k in range(6):
            values[:, k] += scenes.random_walk(rng, count, walk * NOISE[k])
    return Warmup(np.arange(count) / RATE, temperature, np.rint(values / QUANTA) * QUANTA)


def _ours(data: Warmup) -> Answer | None:
    values, sds = [], []
    for sensor, unit, columns in ((Sensor.ACCEL, "m/s2", slice(0, 3)), (Sensor.GYRO, "rad/s", slice(3, 6))):
        channel = Channel(
            sensor,
            0,
            data.t,
            data.values[:, columns],
            unit,
            Stage.RAW,
            "bench",
            quantum=float(QUANTA[columns][0]),
            rounding=Rounding.NEAREST,
        )
        found = fit_polynomial(channel, data.temperature, degree=3, t_ref=T_REF)
        if found.status == FitStatus.REFUSED or found.model.polynomial is None:
            return None
        values.append(np.where(np.isnan(found.sd[12:]), np.nan, found.values[12:]))
        sds.append(found.sd[12:])
    whole = np.concatenate(values)
    return Answer(whole, whole, np.concatenate(sds))


def _polyfit(data: Warmup) -> Answer:
    found = [np.polyfit(data.temperature - T_REF, data.values[:, k], 3)[2::-1] for k in range(6)]
    return Answer(np.concatenate(found))


def _averaged(data: Warmup) -> Answer:
    """Means of two seconds, then polyfit: what ArduPilot's tempcal_IMU does."""
    width = int(2.0 * RATE)
    usable = len(data.t) // width * width
    temperature = data.temperature[:usable].reshape(-1, width).mean(axis=1) - T_REF
    means = data.values[:usable].reshape(-1, width, 6).mean(axis=1)
    return Answer(np.concatenate([np.polyfit(temperature, means[:, k], 3)[2::-1] for k in range(6)]))


def _information(temperature: Array) -> Array:
    """(18, 18) of the three coefficients of six axes, every level unknown."""
    total = np.zeros((18, 18))
    for k in range(6):
        whole = bounds.polynomial(temperature - T_REF, 3, bounds.variance_of(float(NOISE[k]), float(QUANTA[k])))
        part = whole[1:, 1:] - np.outer(whole[1:, 0], whole[0, 1:]) / whole[0, 0]
        total[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = part
    return total


def _draw(count: int, walk: float) -> Callable[[np.random.Generator], Drawn]:
    information = _information(_warmup(np.random.default_rng(0), count, 0.0).temperature)

    def draw(rng: np.random.Generator) -> Drawn:
        return Drawn(_warmup(rng, count, walk), CUBICS.ravel(), information)

    return draw


def run(settings: Settings) -> Iterator[Part]:
    """White noise, a slow wander, and the time of it."""
    for title, walk in (("white noise", 0.0), ("a walk of a third of the noise", 0.33)):
        white = walk == 0.0
        contenders = [
            Contender(
                "**mavcal thermal-poly**", _ours, ours=True, target=TARGET if white else None, exact=False, honest=True
            ),
            Contender("numpy polyfit", _polyfit),
            Contender("means of 2 s, polyfit (tempcal_IMU)", _averaged),
        ]
        tallies = []
        for count in settings.sizes([10_000, 100_000, 1_000_000]):
            count = min(count, settings.largest)
            case = Case(title, count, _draw(count, walk), settings.runs(count), settings.seed_of(title, count))
            settings.say(f"temperature, {title}, N = {count}, {case.runs} runs, seed {case.seed}")
            tallies += run_case(case, contenders, settings.budget)
        notes = [] if white else ["The bound is that of white noise: what counts here is whether the intervals hold."]
        yield accuracy_part(f"Temperature: {title}", tallies, notes=notes)
    yield _speed(settings)


def _speed(settings: Settings) -> Part:
    count = settings.largest
    data = _warmup(np.random.default_rng(settings.seed_of("thermal speed", count)), count, 0.0)
    x = (data.temperature - 42.0) / 20.0
    taken = 1e3 * best_of(5, lambda: DriftBlocks.of(x, data.t, data.values, degree=3))
    met = taken <= 25.0 if count == 1_000_000 else None
    rows = (
        Row("normal equations of six channels", "<= 25 ms", f"{taken:.1f} ms", met),
        beside("two whole fits of three channels, beside numpy polyfit", lambda: _ours(data), lambda: _polyfit(data)),
    )
    return Part.of_section(Section(f"Temperature: time at N = {count}", rows))
