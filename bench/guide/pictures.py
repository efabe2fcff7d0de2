"""The pictures of ``docs/methods.md``: every number in them is computed here, from recordings made by a seed."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from mavcal.calib.drawing import Chart, Key, SphereMap, side_by_side
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Recording, Sensor
from mavcal.calib.simulate import (
    MotionOptions,
    SensorErrors,
    SensorSuite,
    Warming,
    along,
    motion_of,
    simulate,
    trajectory,
)

GREY = "#6b7a86"
BLUE, ORANGE, GREEN, RED = "#1f6fb2", "#d9731a", "#2f8f5b", "#c0392b"
_RUNS = 8
_IRON = 0.03  # soft iron of the tilted compass, and its prior
FIELD = np.array([21.0, 1.1, 43.2])  # uT, dip 64 deg
MAG = SensorErrors(
    bias=np.array([12.0, -8.5, 21.0]),
    matrix=np.array([[1.10, 0.06, -0.04], [0.06, 0.90, 0.05], [-0.04, 0.05, 1.0]]),
    noise_density=0.3 / np.sqrt(50.0),
)
ACCEL = SensorErrors(
    bias=np.array([0.31, -0.22, 0.17]),
    matrix=np.array([[1.012, 0.004, -0.003], [-0.002, 0.991, 0.005], [0.003, -0.004, 1.006]]),
    noise_density=0.02 / np.sqrt(100.0),
)


def coverage() -> str:
    """Which directions of the field a motion shows the compass, and what the heading is then good to."""
    maps: list[SphereMap | Chart] = []
    for limit in (90.0, 45.0, 20.0):
        recording = _tilted(limit, 60.0)
        mag = recording.channel(Sensor.MAG)
        fit = _mag("mag-ellipsoid", recording)
        inside = np.linalg.solve(MAG.matrix, (mag.values - MAG.bias).T).T
        shown = f"mag-ellipsoid: heading sd {fit.quality['heading_sd_deg']:.2g}°"
        shown = shown if fit.status == FitStatus.OK else f"mag-ellipsoid: {fit.status.value}"
        whole = "turned to every side" if limit > 80 else f"tilted by at most {limit:.0f}°"
        made = SphereMap(whole, shown, width=300, height=205)
        made.dots(inside[::4], BLUE)
        maps.append(made)
    return side_by_side(maps, "Field directions that three motions cover, and the heading error that follows")


def magnetometer_residuals() -> str:
    """Length of the corrected field over time, less its mean, by four methods on the same samples."""
    recording = _tilted(90.0, 60.0)
    mag = recording.channel(Sensor.MAG)
    plots: list[SphereMap | Chart] = []
    for name, colour in (("mag-minmax", RED), ("mag-sphere", ORANGE), ("mag-ellipsoid", BLUE)):
        length = np.linalg.norm(_mag(name, recording).model.apply(mag.values), axis=1)
        residual = length / length.mean() - 1.0
        plot = Chart(
            f"{name}: {100 * residual.std():.2g} % rms", "s", "|field| − mean, %", (0.0, 60.0), (-15.0, 15.0), 300
        )
        plot.dots(mag.t[::3], 100 * residual[::3], colour, size=1.0)
        plots.append(plot)
    return side_by_side(plots, "Residuals of three magnetometer methods on the same samples")


def tilt() -> str:
    """Error and stated uncertainty of the offset against how far the vehicle is tilted, with a prior and without."""
    limits = np.array([10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 60.0, 75.0])
    plot = Chart(
        "Offset of the compass",
        "largest tilt, degrees",
        "µT",
        (5, 80),
        (0.01, 100),
        440,
        270,
        log_y=True,
        legend_inside=True,
    )
    for prior, colour in ((None, BLUE), (_IRON, ORANGE)):
        shown: list[tuple[float, float, float]] = []
        for k, limit in enumerate(limits):
            fits = [found for n in range(_RUNS) if (found := _offset_error(limit, prior, seed=10 * k + n)) is not None]
            if len(fits) == _RUNS:
                error, stated = np.sqrt(np.mean(np.square(fits), axis=0))
                shown.append((limit, error, stated))
        at, errors, stated_sd = (list(column) for column in zip(*shown, strict=True))
        plot.line(at, stated_sd, colour, "no prior" if prior is None else f"--prior-sd {prior:g}")
        plot.dots(at, errors, colour, size=3.0)
    plot.legend.append(Key(GREY, f"line: stated sd; dots: error, rms of {_RUNS} runs"))
    return side_by_side(
        [plot], "Offset error and stated uncertainty against the largest tilt, with a prior and without"
    )


def fixture() -> str:
    """Error of the accelerometer's cross terms against how square the fixture is: six faces and free poses."""
    tilts = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0])
    plot = Chart(
        "Cross terms of the accelerometer",
        "tilt of the fixture, degrees",
        "rms error",
        (0.01, 2.0),
        (1e-5, 0.1),
        440,
        270,
        log_x=True,
        log_y=True,
    )
    for motion, method, colour in (("six-faces", "accel-six-face", ORANGE), ("poses", "accel-multi", BLUE)):
        found = [np.sqrt(np.mean([_cross_error(motion, method, t, s) ** 2 for s in range(4)])) for t in tilts]
        plot.line(tilts, found, colour, method)
        plot.dots(tilts, found, colour, size=2.5)
    return side_by_side([plot], "Error of the cross terms against the tilt of the fixture")


def warm_up() -> str:
    """A drift with temperature, the polynomial through it with its uncertainty, and what is left."""
    errors = SensorErrors(
        temperature=np.array([[6e-3, 1.2e-4, -1.0e-6]] * 3), t_ref=35.0, noise_density=0.01, random_walk=2e-4
    )
    motion = motion_of("warm-up", MotionOptions(duration=1200.0), np.random.default_rng(0))
    path = trajectory(motion.legs, 10.0, field=FIELD, start=motion.start, warming=Warming(15.0, 62.0, 300.0))
    recording = simulate(path, SensorSuite(accel=errors), np.random.default_rng(3)).recording
    (fit,) = (f for f in METHODS["thermal-poly"].run(recording, {}) if f.sensor == Sensor.ACCEL)
    accel = recording.channel(Sensor.ACCEL)
    at = np.interp(accel.t, path.t, path.temperature)
    assert fit.model.polynomial is not None
    drift = accel.values[:, 0] - accel.values[:, 0].mean()
    curve = fit.model.polynomial(at)[:, 0]
    level = float((drift - curve).mean())
    low, high = at.min(), at.max()
    left = Chart("accelerometer x", "°C", "m/s² about the mean", (10.0, 65.0), (-0.4, 0.3), 330)
    left.dots(at[::17], drift[::17], GREY, "samples", size=0.9)
    grid = np.linspace(low, high, 60)
    left.line(grid, fit.model.polynomial(grid)[:, 0] + level, BLUE, "thermal-poly")
    residual = drift - curve - level
    right = Chart("what is left", "s", "m/s²", (0.0, 1200.0), (-0.15, 0.15), 330)
    right.dots(accel.t[::17], residual[::17], GREY, "samples", size=0.9)
    blocks = residual[: len(residual) // 200 * 200].reshape(-1, 200)
    right.line(accel.t[100::200][: len(blocks)], blocks.mean(axis=1), ORANGE, "means of 20 s")
    return side_by_side([left, right], "Drift with temperature, its polynomial, and the residuals over time")


def allan() -> str:
    """The Allan deviation of white noise, flicker and a random walk together, with what the method reads off it."""
    errors = SensorErrors(noise_density=1e-3, bias_instability=1.5e-4, random_walk=2e-5)
    motion = motion_of("rest", MotionOptions(duration=28_800.0), np.random.default_rng(0))
    path = trajectory(motion.legs, 5.0, field=FIELD, start=motion.start)
    recording = simulate(path, SensorSuite(gyro=errors), np.random.default_rng(6)).recording
    (fit,) = METHODS["allan"].run(recording, {"sensor": "gyro"})
    tau, deviation = np.array(fit.native["tau"]), np.array(fit.native["adev"])[0]
    plot = Chart(
        "Allan deviation of a gyroscope, eight hours",
        "averaged over, s",
        "rad/s",
        (0.1, 5000.0),
        (5e-5, 1e-2),
        440,
        280,
        log_x=True,
        log_y=True,
    )
    plot.dots(tau, deviation, BLUE, "overlapping deviation", size=2.5)
    for name, slope, colour in (("N", -0.5, ORANGE), ("B", 0.0, GREEN), ("K", 0.5, RED)):
        value = fit.native[name][0]
        if value is not None:
            factor = {"N": 1.0, "B": np.sqrt(2.0 * np.log(2.0) / np.pi), "K": np.sqrt(1.0 / 3.0)}[name]
            plot.line(tau, value * factor * tau**slope, colour, f"{name} = {value:.2g}", dashed=True)
    return side_by_side([plot], "Allan deviation with the lines of N, B and K")


PICTURES: Mapping[str, Callable[[], str]] = {
    "coverage": coverage,
    "residuals": magnetometer_residuals,
    "tilt": tilt,
    "fixture": fixture,
    "warm-up": warm_up,
    "allan": allan,
}
"""By the name of their file."""


def _tilted(limit_deg: float, seconds: float, seed: int = 1, sensor: SensorErrors = MAG) -> Recording:
    """Turning about the vertical while tilting up to a limit; beyond 80 degrees, over in every direction."""
    rng = np.random.default_rng(seed)
    suite = SensorSuite(mag=sensor)
    if limit_deg > 80.0:
        motion = motion_of("tumble", MotionOptions(duration=seconds), rng)
        path = trajectory(motion.legs, 50.0, field=FIELD, start=motion.start)
        return simulate(path, suite, rng).recording
    t = np.arange(0.0, seconds, 0.02)
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    size = np.radians(limit_deg) * np.sqrt((1.0 + np.sin(0.39 * t + phase[0])) / 2.0)
    side = 0.53 * t + phase[1]
    axis = np.column_stack([np.cos(side), np.sin(side), np.zeros_like(t)])
    attitude = Rotation.from_rotvec(size[:, None] * axis) * Rotation.from_rotvec(
        np.outer(0.61 * t + phase[2], [0, 0, 1.0])
    )
    return simulate(along(t, attitude, field=FIELD), suite, rng).recording


def _mag(method: str, recording: Recording, **options: float) -> FitResult:
    (fit,) = METHODS[method].run(recording, options)
    return fit


def _offset_error(limit: float, prior: float | None, seed: int) -> tuple[float, float] | None:
    """Length of the error of the offset, and its stated sd, uT; None: the fit was refused."""
    draw = np.random.default_rng(1000 + seed).normal(size=(3, 3))
    iron = _IRON * (np.triu(draw) + np.triu(draw, 1).T)
    sensor = dataclasses.replace(MAG, matrix=np.eye(3) + iron)
    fit = _mag("mag-ellipsoid", _tilted(limit, 40.0, seed, sensor), **({} if prior is None else {"prior_sd": prior}))
    if fit.status == FitStatus.REFUSED:
        return None
    return float(np.linalg.norm(fit.model.offset - MAG.bias)), float(np.linalg.norm(fit.sd[:3]))


def _cross_error(motion: str, method: str, tilt_deg: float, seed: int) -> float:
    rng = np.random.default_rng(100 + seed)
    made = motion_of(motion, MotionOptions(duration=3.0, fixture_sd=tilt_deg, poses=12), rng)
    path = trajectory(made.legs, 100.0, field=FIELD, start=made.start)
    recording = simulate(path, SensorSuite(accel=ACCEL), rng).recording
    (fit,) = METHODS[method].run(recording, {})
    truth = ACCEL.correction.symmetric().matrix
    off = ~np.eye(3, dtype=bool)
    return float(np.sqrt(((fit.model.symmetric().matrix - truth)[off] ** 2).mean()))
