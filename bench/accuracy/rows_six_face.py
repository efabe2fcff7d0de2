"""Six faces on a perfect fixture: twelve numbers of an accelerometer, at any noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from bench.accuracy import bounds, peers
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, run_case
from bench.accuracy.tables import Part, accuracy_part
from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.accel.faces import Face
from mavcal.calib.accel.six_face import fit_six_face
from mavcal.calib.fit import FitStatus
from mavcal.calib.noise.coarse_means import means_together
from mavcal.calib.recording import Channel, Rounding, Sensor, Stage

Array = NDArray[np.float64]
Faces = list[Array]
"""Samples (n, 3) of each face, in the order of :data:`DOWNS`."""

MILLI_G = 1e-3 * STANDARD_GRAVITY
DOWNS = np.vstack([np.eye(3), -np.eye(3)])
TRUTHS = -STANDARD_GRAVITY * DOWNS  # specific force: the axis that points down reads -g

MATRIX = np.array([[1.012, 0.004, -0.006], [-0.003, 0.991, 0.005], [0.002, -0.007, 1.006]])
OFFSET = np.array([0.21, -0.14, 0.33])
TYPICAL = np.concatenate([OFFSET, MATRIX.ravel()])
TARGET = 1.02

_COARSE = (
    "Below half a bin of noise the bound is that of each face's mean with its own noise unknown; all faces together "
    "know the noise better, so a ratio below 1 is no mistake. How much a face tells depends on where in its bin it "
    "lies: every run has a sensor of its own."
)


def _ours(faces: Faces) -> Answer | None:
    means = means_together([_channel(samples) for samples in faces])
    found = fit_six_face([Face(m.mean, m.covariance, down, n=m.n) for m, down in zip(means, DOWNS, strict=True)])
    if found.status != FitStatus.OK:
        return None
    matrix = np.linalg.inv(found.model.matrix)
    return Answer(np.concatenate([found.model.offset, matrix.ravel()]), found.values, found.sd)


def _channel(samples: Array) -> Channel:
    t = np.arange(len(samples)) / 100.0
    return Channel(Sensor.ACCEL, 0, t, samples, "m/s2", Stage.RAW, "bench", quantum=MILLI_G, rounding=Rounding.NEAREST)


def _accelcal(samples: Array, targets: Array) -> Answer:
    """``C = U A + b`` by rows: regresses the known on the noisy, as accelcal does."""
    found = np.linalg.lstsq(np.hstack([samples, np.ones((len(samples), 1))]), targets, rcond=None)[0]
    matrix = np.linalg.inv(found[:3].T)
    return Answer(np.concatenate([-matrix @ found[3], matrix.ravel()]))


def _accelcal_all(faces: Faces) -> Answer:
    return _accelcal(np.vstack(faces), np.repeat(TRUTHS, [len(f) for f in faces], axis=0))


def _accelcal_means(faces: Faces) -> Answer:
    return _accelcal(np.array([f.mean(axis=0) for f in faces]), TRUTHS)


def _ferraris(faces: Faces) -> Answer:
    """imucal; its regions are called after the axis that reads +g, and it wants a gyro that turned."""
    from imucal import FerrarisCalibration, FerrarisSignalRegions

    still, turned = np.zeros((10, 3)), np.zeros((100, 3))
    order = [3, 0, 4, 1, 5, 2]  # x reads +g: its down is -x, and so on
    regions = {}
    for name, k in zip(("x_p", "x_a", "y_p", "y_a", "z_p", "z_a"), order, strict=True):
        regions[f"acc_{name}"], regions[f"gyr_{name}"] = faces[k], still
    for axis in range(3):
        spin = turned.copy()
        spin[:, axis] = 360.0
        regions[f"acc_{'xyz'[axis]}_rot"], regions[f"gyr_{'xyz'[axis]}_rot"] = turned + faces[0][:1], spin
    info = FerrarisCalibration(grav=STANDARD_GRAVITY, expected_angle=360.0).compute(
        FerrarisSignalRegions(**regions), sampling_rate_hz=100.0, from_acc_unit="m/s^2", from_gyr_unit="deg/s"
    )
    return Answer(np.concatenate([info.b_a, (info.K_a @ info.R_a).ravel()]))


def contenders() -> tuple[list[Contender], list[str]]:
    found = [
        Contender("**mavcal accel-six-face**", _ours, ours=True, target=TARGET, exact=False),
        Contender("accelcal form, all samples", _accelcal_all),
        Contender("accelcal form, face means", _accelcal_means),
    ]
    reason = peers.usable("imucal", _ferraris, _read(np.random.default_rng(0), TYPICAL, 100, 0.03))
    version = peers.version_of("imucal")
    if reason:
        return found, [f"imucal Ferraris ({version or ''}): {reason}".replace(" ()", "")]
    return [*found, Contender(f"PyPI imucal {version} Ferraris", _ferraris)], []


def _sensor(rng: np.random.Generator) -> Array:
    """The twelve numbers of one sensor: nobody's errors are multiples of a bin."""
    spread = np.concatenate([np.full(3, 2.0 * MILLI_G), np.full(9, 2e-3)])
    return TYPICAL + spread * rng.uniform(-1.0, 1.0, 12)


def _read(rng: np.random.Generator, truth: Array, count: int, sd: float) -> Faces:
    offset, matrix = truth[:3], truth[3:].reshape(3, 3)
    noise = (sd * rng.normal(size=(count, 3)) for _ in TRUTHS)
    return [np.rint((matrix @ f + offset + n) / MILLI_G) * MILLI_G for f, n in zip(TRUTHS, noise, strict=True)]


def _information(truth: Array, count: int, sd: float) -> Array:
    """Information on the twelve numbers: what the bins say of every face's mean, the noise of every axis unknown."""
    offset, matrix = truth[:3], truth[3:].reshape(3, 3)
    total = np.zeros((12, 12))
    for force in TRUTHS:
        row = np.concatenate([[1.0], force])
        for axis in range(3):
            worth = count * bounds.interval_mean(float(matrix[axis] @ force + offset[axis]), sd, MILLI_G)
            places = [axis, *(3 + 3 * axis + j for j in range(3))]
            total[np.ix_(places, places)] += worth * np.outer(row, row)
    return total


def _draw(count: int, sd: float) -> Callable[[np.random.Generator], Drawn]:
    def draw(rng: np.random.Generator) -> Drawn:
        truth = _sensor(rng)
        stored = np.concatenate([truth[:3], np.linalg.inv(truth[3:].reshape(3, 3)).ravel()])
        return Drawn(_read(rng, truth, count, sd), truth, _information(truth, count, sd), stored)

    return draw


def run(settings: Settings) -> Iterator[Part]:
    """A table a noise level; quantised to 1 mG."""
    found, missing = contenders()
    for noise in (0.2, 0.3, 1.0, 3.0, 20.0):
        title = f"Six faces, noise of {noise:g} mG"
        tallies = []
        for count in settings.sizes([100, 1000, 10_000]):
            case = Case(
                title, 6 * count, _draw(count, noise * MILLI_G), settings.runs(count), settings.seed_of(title, count)
            )
            settings.say(f"{title}, {count} a face, {case.runs} runs, seed {case.seed}")
            tallies += run_case(case, found, settings.budget)
        notes = [_COARSE] if noise < 0.5 else []
        yield accuracy_part(title, tallies, missing, notes)
