"""Multi-position calibration of accelerometer and gyroscope, from poses held by hand and the movements between them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.accuracy import bounds, scenes
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, run_case
from bench.accuracy.tables import Part, accuracy_part
from bench.rows import Row, Section, best_of
from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.imu import fit_imu
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage

Array = NDArray[np.float64]

RATE, HOLD, MOVE = 100.0, 3.0, 1.8
MILLI_G = 1e-3 * STANDARD_GRAVITY
ACCEL = np.array([[1.012, 0.004, -0.003], [0.004, 0.991, 0.005], [-0.003, 0.005, 1.006]])
GYRO = np.array([[1.010, 0.006, -0.004], [-0.003, 0.985, 0.005], [0.004, -0.006, 1.014]])
ACCEL_OFFSET, GYRO_OFFSET = np.array([0.21, -0.14, 0.33]), np.array([0.012, -0.007, 0.004])
ACCEL_SD, GYRO_SD = 3.0 * MILLI_G, 3e-3
SIX = tuple(np.array(bounds.SYMMETRIC).T)
UNIT = bounds.Unit(
    ACCEL, GYRO, bounds.variance_of(ACCEL_SD, MILLI_G), bounds.variance_of(GYRO_SD, 1e-3), STANDARD_GRAVITY
)
TRUTHS = {"accelerometer": np.concatenate([ACCEL_OFFSET, ACCEL[SIX]]), "gyroscope": GYRO.ravel()}
TARGET = 1.10


@dataclass(frozen=True, eq=False)
class Held:
    """What the sensors read (N, 3), and what truly happened: rates and verticals (N, 3), and where it was still."""

    accel: Channel
    gyro: Channel
    rates: Array
    downs: Array
    spans: Array


def held(rng: np.random.Generator, poses: int) -> Held:
    """`poses` in random directions, each held; turned into the next about a random axis, rate as half a sine."""
    still, turning = round(HOLD * RATE), round(MOVE * RATE)
    rates, spans = [], []
    for k in range(poses):
        spans.append([k * (still + turning) / RATE, (k * (still + turning) + still - 0.5) / RATE])
        rates.append(np.zeros((still, 3)))
        if k < poses - 1:
            angle = math.radians(rng.uniform(60.0, 150.0))
            profile = np.sin(math.pi * (np.arange(turning) + 0.5) / turning)
            profile *= angle * RATE / profile.sum()
            rates.append(np.outer(profile, scenes.everywhere(rng, 1)[0]))
    rate = np.vstack(rates)
    down = np.empty_like(rate)
    d = scenes.everywhere(rng, 1)[0]
    for i, w in enumerate(rate):
        down[i] = d
        if w.any():
            d = bounds._turned(w, 1.0 / RATE) @ d
    t = np.arange(len(rate)) / RATE
    accel = -STANDARD_GRAVITY * down @ ACCEL.T + ACCEL_OFFSET + ACCEL_SD * rng.normal(size=rate.shape)
    gyro = rate @ GYRO.T + GYRO_OFFSET + GYRO_SD * rng.normal(size=rate.shape)
    return Held(
        _channel(Sensor.ACCEL, t, accel, "m/s2", MILLI_G),
        _channel(Sensor.GYRO, t, gyro, "rad/s", 1e-3),
        rate,
        down,
        np.array(spans),
    )


def _channel(sensor: Sensor, t: Array, values: Array, unit: str, quantum: float) -> Channel:
    rounded = np.rint(values / quantum) * quantum
    return Channel(sensor, 0, t, rounded, unit, Stage.RAW, "bench", quantum=quantum, rounding=Rounding.NEAREST)


def _bound(data: Held, spans: Array, which: str) -> Array:
    """Information on one sensor's nine numbers in the samples of `spans`, all the others unknown."""
    found = np.searchsorted(data.accel.t, spans)
    whole = np.linalg.inv(bounds.joint(UNIT, [(int(a), int(b)) for a, b in found], data.rates, data.downs, 1.0 / RATE))
    part = slice(0, 9) if which == "accelerometer" else slice(9, 18)
    return np.linalg.inv(whole[part, part])


def _ours(which: str) -> Callable[[Held], Answer | None]:
    def run(data: Held) -> Answer | None:
        accel, gyro = fit_imu(data.accel, data.gyro)
        if FitStatus.REFUSED in (accel.status, gyro.status):
            return None
        spans = np.array(accel.quality["spans"])
        values, stored, sd = _numbers(accel if which == "accelerometer" else gyro, which)
        return Answer(values, stored, sd, bound=lambda: _bound(data, spans, which))

    return run


def _numbers(fit: FitResult, which: str) -> tuple[Array, Array, Array]:
    matrix = np.linalg.inv(fit.model.matrix)
    if which == "gyroscope":
        return matrix.ravel(), fit.values[3:], fit.sd[3:]
    rows = [0, 1, 2, *(3 + 3 * i + j for i, j in bounds.SYMMETRIC)]
    return np.concatenate([fit.model.offset, matrix[SIX]]), fit.values[rows], fit.sd[rows]


def _draw(poses: int, which: str) -> Callable[[np.random.Generator], Drawn]:
    if which == "gyroscope":
        stored = np.linalg.inv(GYRO).ravel()
    else:
        stored = np.concatenate([ACCEL_OFFSET, np.linalg.inv(ACCEL)[SIX]])

    def draw(rng: np.random.Generator) -> Drawn:
        data = held(rng, poses)
        return Drawn(data, TRUTHS[which], np.eye(9), stored)

    return draw


def run(settings: Settings) -> Iterator[Part]:
    """Both sensors against the joint bound of the samples that the detector keeps, and the time of it."""
    for which in TRUTHS:
        title = f"Multi-position, {which}"
        tallies = []
        for poses in [12] if settings.quick else [12, 20, 40]:
            seed = settings.seed_of("multi-position", poses)
            runs = min(settings.runs(poses), 5) if settings.quick else settings.runs(poses)
            case = Case(title, poses, _draw(poses, which), runs, seed)
            settings.say(f"{title}, {poses} poses, {runs} runs, seed {seed}")
            contenders = [Contender("**mavcal imu-multi**", _ours(which), ours=True, target=TARGET, exact=False)]
            tallies += run_case(case, contenders, settings.budget)
        notes = ["N is the number of poses; the bound is that of the samples that the detector keeps."]
        yield accuracy_part(title, tallies, notes=notes)
    data = held(np.random.default_rng(settings.seed_of("multi-position time", 40)), 40)
    taken = best_of(3, lambda: fit_imu(data.accel, data.gyro))
    row = Row("40 poses", "<= 0.5 s", f"{taken:.2f} s", None if settings.quick else taken <= 0.5)
    yield Part.of_section(Section("Multi-position: time", (row,), ("Processor time, best of three.",)))
