"""``python -m bench.gap_picture``: ``docs/pictures/gap-report.png``, the page of a diagnosis as Chromium shows it.

A minute of tumbling while it warms up, made by a seed: an accelerometer with an offset that follows the temperature, a
magnetometer with hard and soft iron. Everything on the page is computed here.
"""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from mavcal.calib import gap
from mavcal.calib.gap.schema import GapReport
from mavcal.calib.gap_report import gap_to_html
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.calib.simulate import (
    MotionOptions,
    SensorErrors,
    SensorSuite,
    Simulated,
    Warming,
    motion_of,
    simulate,
    trajectory,
)

OUT = Path(__file__).resolve().parents[1] / "docs" / "pictures" / "gap-report.png"
RATE = 100.0
FIELD = np.array([21.0, 1.1, 43.2])  # uT
SIZE = (1000, 2300)
QUIET = {Sensor.ACCEL: np.full(3, 0.003), Sensor.GYRO: np.full(3, 3e-4), Sensor.MAG: np.full(3, 0.05)}
CLEAN = SensorSuite(
    accel=SensorErrors(noise_density=QUIET[Sensor.ACCEL]),
    gyro=SensorErrors(noise_density=QUIET[Sensor.GYRO]),
    mag=SensorErrors(noise_density=QUIET[Sensor.MAG]),
)
REAL = SensorSuite(
    accel=SensorErrors(
        noise_density=QUIET[Sensor.ACCEL],
        temperature=np.array([[0.008], [-0.005], [0.012]]),
        t_ref=35.0,
        bias=np.array([0.05, 0.02, -0.03]),
    ),
    gyro=CLEAN.gyro,
    mag=SensorErrors(
        noise_density=QUIET[Sensor.MAG], bias=np.array([-6.0, 4.0, -3.0]), matrix=np.diag([1.05, 0.93, 1.02])
    ),
)


def recorded(suite: SensorSuite, seed: int, *, seconds: float = 60.0, rate: float = RATE) -> Recording:
    """A flight of `suite`, with what ideal sensors would have read beside it."""
    rng = np.random.default_rng(seed)
    motion = motion_of("tumble", MotionOptions(duration=seconds), rng)
    path = trajectory(motion.legs, rate, field=FIELD, start=motion.start, warming=Warming(22.0, 55.0, 25.0))
    made = simulate(path, suite, rng, mag_rate=min(rate, RATE))
    return dataclasses.replace(made.recording, reference=_ideal(made))


def _ideal(made: Simulated) -> tuple[Channel, ...]:
    path = made.trajectory
    readings = ((Sensor.ACCEL, path.force, "m/s2"), (Sensor.GYRO, path.rate, "rad/s"), (Sensor.MAG, path.field, "uT"))
    return tuple(Channel(sensor, 0, path.t, values, unit, Stage.RAW, "reference") for sensor, values, unit in readings)


def example() -> GapReport:
    """The diagnosis that the picture shows."""
    clean = [recorded(CLEAN, seed) for seed in (11, 12)]
    return gap.run(recorded(REAL, 10), nominal=clean, nested=False)


def main() -> int:
    """Draw it; 1 where there is no Chromium."""
    browser = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
    if browser is None:
        sys.stderr.write("there is no chromium: install it to draw the picture\n")
        return 1
    with tempfile.TemporaryDirectory() as folder:
        page = Path(folder) / "gap.html"
        page.write_text(gap_to_html(example(), title="Sim-to-real gap of a warming flight"), encoding="utf-8")
        subprocess.run(
            [
                *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
                *("--hide-scrollbars", f"--window-size={SIZE[0]},{SIZE[1]}", f"--user-data-dir={folder}/profile"),
                *(f"--screenshot={OUT}", page.as_uri()),
            ],
            check=True,
            capture_output=True,
            timeout=120,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
