"""Many simulated compass jobs, and how often the truth lies within what they state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.compass.scene import QUANTA, turned
from mavcal.calib.firmware.stream.messages import COMPASS_WINDOW
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.mag.blur import rates_during
from mavcal.calib.mag.blur_fit import fit_ellipsoid_deblurred
from mavcal.calib.procedures.context import ProcedureContext
from mavcal.calib.procedures.protocol import Done
from mavcal.calib.procedures.replay import replay
from mavcal.calib.recording import Sensor
from mavcal.service.simvehicle.rotation import Array

WINDOW = COMPASS_WINDOW["ardupilot"]
KINDS = ("offset", "DIA", "ODI")
SECONDS = {0.0: 120.0, 15.0: 150.0}
"""Longest turning, by the rate in deg/s; other rates: 60 s."""

FITTED = {0.0: 60.0, 15.0: 60.0}
"""Turning where no job decides, by the rate in deg/s; other rates: 30 s."""

_NINE = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))


@dataclass(frozen=True)
class Cell:
    """How a vehicle is turned, deg/s, and the noise of its compasses, uT."""

    rate: float
    noise: float


@dataclass
class Tally:
    """What came of the runs of a cell; `whole`: of the compasses whose stream is in whole mG."""

    cell: Cell
    whole: bool
    deviations: list[Array] = field(default_factory=list)
    """Error over sd of the nine numbers, a compass at a time."""
    offset_errors: list[float] = field(default_factory=list)
    """Length of the error of the offset, uT."""
    seconds: list[float] = field(default_factory=list)
    unfinished: int = 0

    def add(self, fit: FitResult | None, truth: Array) -> None:
        """Take a `fit` of a compass whose numbers are `truth`; None: it did not come to one."""
        if fit is None or fit.status == FitStatus.REFUSED:
            self.unfinished += 1
            return
        self.deviations.append(deviations(fit, truth))
        self.offset_errors.append(float(np.linalg.norm(fit.model.offset - truth[:3])))
        self.seconds.append(fit.n_samples / 10.0)

    def held(self, kind: str | None = None) -> float:
        """Share of the 95 % intervals of a kind of parameter that hold the truth; None: of all."""
        return float(np.mean(self._by_fit(kind)))

    def held_sd(self, kind: str | None = None) -> float:
        """Standard deviation of that by chance.

        The intervals of a compass are not independent: the three of DIA, whose product is one, hold two numbers.
        """
        by_fit = self._by_fit(kind)
        seen = float(np.std(by_fit)) / max(len(by_fit) - 1, 1) ** 0.5
        least = 0.05 * 0.95 / ((9.0 if kind is None else 3.0) * len(by_fit))  # of independent intervals, 95 % of them
        return max(seen, float(least) ** 0.5)

    def _by_fit(self, kind: str | None) -> Array:
        rows = np.array(self.deviations).reshape(-1, 3, 3)
        if kind is not None:
            rows = rows[:, [KINDS.index(kind)]]
        return np.asarray(np.mean(np.abs(rows) < 1.96, axis=(1, 2)))

    @property
    def rms(self) -> float:
        """Root mean square of error over sd: 1 where the stated uncertainty is true."""
        return float(np.sqrt(np.mean(np.square(self.deviations))))


def deviations(fit: FitResult, truth: Array) -> Array:
    """Error over sd (9,): offset, diagonal and cross terms of the matrix with determinant 1."""
    matrix = fit.model.matrix
    scale = float(np.cbrt(np.linalg.det(matrix)))
    inverse = np.linalg.inv(matrix)
    jacobian = np.eye(12)
    for k in range(9):
        unit = np.zeros(9)
        unit[k] = 1.0
        change = unit.reshape(3, 3) - matrix * np.trace(inverse @ unit.reshape(3, 3)) / 3.0
        jacobian[3:, 3 + k] = change.ravel() / scale
    rows = [0, 1, 2, *(3 + 3 * i + j for i, j in zip(*_NINE, strict=True))]
    sd = np.sqrt(np.diag(jacobian @ fit.covariance @ jacobian.T))[rows]
    return np.asarray((np.concatenate([fit.model.offset, (matrix / scale)[_NINE]]) - truth) / sd)


def run_cell(cell: Cell, seeds: Sequence[int], uncertainty: float = 0.3) -> tuple[Tally, Tally]:
    """The jobs of `seeds`; compasses with all their digits, and those in whole mG."""
    tallies = Tally(cell, whole=False), Tally(cell, whole=True)
    for seed in seeds:
        made = turned(seed, cell.rate, cell.noise, SECONDS.get(cell.rate, 60.0))
        context = ProcedureContext(made.recording.identity, earth_field=made.field)
        done = replay("mag", {"uncertainty": uncertainty}, context, made.recording)
        fits = {f.instance: f for f in done.results} if isinstance(done, Done) else {}
        for k, truth in enumerate(made.truth):
            tallies[int(QUANTA[k] > 0.0)].add(fits.get(k), truth)
    return tallies


def fit_cell(cell: Cell, seeds: Sequence[int]) -> tuple[Tally, Tally]:
    """As :func:`run_cell`, but fits of :data:`FITTED` seconds: a job chooses when it ends, and takes longer to run."""
    tallies = Tally(cell, whole=False), Tally(cell, whole=True)
    for seed in seeds:
        made = turned(seed, cell.rate, cell.noise, FITTED.get(cell.rate, 30.0))
        (gyro,) = made.recording.find(Sensor.GYRO)
        for k, truth in enumerate(made.truth):
            mag = made.recording.channel(Sensor.MAG, k)
            rates = rates_during(mag.t, gyro.t, gyro.values, WINDOW)
            fit = fit_ellipsoid_deblurred(mag.values, rates, quantum=mag.quantum, field=made.field)
            tallies[int(QUANTA[k] > 0.0)].add(fit, truth)
    return tallies


def table(tallies: Sequence[Tally]) -> str:
    """Markdown; behind each share of intervals two of its standard deviations."""
    names = ("deg/s", "noise, mG", "stream", "fits", *KINDS, "all", "error/sd, rms", "offset off by, mG", "samples, s")
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    for t in tallies:
        if not t.deviations:
            lines.append(f"| {t.cell.rate:g} | {10 * t.cell.noise:g} | - | 0 of {t.unfinished} | | | | | | | |")
            continue
        held = " | ".join(f"{100 * t.held(k):.1f} ± {200 * t.held_sd(k):.1f}" for k in (*KINDS, None))
        error = 10.0 * float(np.sqrt(np.mean(np.square(t.offset_errors))))
        left = f" ({t.unfinished} without)" if t.unfinished else ""
        lines.append(
            f"| {t.cell.rate:g} | {10 * t.cell.noise:g} | {'whole mG' if t.whole else 'all digits'} | "
            f"{len(t.deviations)}{left} | {held} | {t.rms:.2f} | "
            f"{error:.3g} | {float(np.mean(t.seconds)):.0f} |"
        )
    return "\n".join(lines)
