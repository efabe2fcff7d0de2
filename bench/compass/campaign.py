"""Many simulated compass jobs, and how often the truth lies within what they state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.compass.scene import QUANTA, turned
from calib.fit import FitResult, FitStatus
from calib.procedures.context import ProcedureContext
from calib.procedures.protocol import Done
from calib.procedures.replay import replay
from service.simvehicle.rotation import Array

KINDS = ("offset", "DIA", "ODI")
SECONDS = {0.0: 120.0, 15.0: 150.0}
"""Of turning at most, by the rate in deg/s; other rates: 60 s."""

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

    def held(self, kind: str) -> float:
        """Share of the 95 % intervals of a kind of parameter that hold the truth."""
        rows = np.array(self.deviations).reshape(-1, 3, 3)[:, KINDS.index(kind)]
        return float(np.mean(np.abs(rows) < 1.96))

    @property
    def share(self) -> float:
        """Of all intervals."""
        return float(np.mean(np.abs(np.array(self.deviations)) < 1.96))

    @property
    def share_sd(self) -> float:
        """Standard deviation of that by chance; the nine intervals of a compass are not independent."""
        by_fit = np.mean(np.abs(np.array(self.deviations)) < 1.96, axis=1)
        return float(np.std(by_fit)) / max(len(by_fit) - 1, 1) ** 0.5

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
            tally = tallies[int(QUANTA[k] > 0.0)]
            if k not in fits or fits[k].status == FitStatus.REFUSED:
                tally.unfinished += 1
                continue
            tally.deviations.append(deviations(fits[k], truth))
            tally.offset_errors.append(float(np.linalg.norm(fits[k].model.offset - truth[:3])))
            tally.seconds.append(fits[k].n_samples / 10.0)
    return tallies


def table(tallies: Sequence[Tally]) -> str:
    """Markdown."""
    names = ("deg/s", "noise, mG", "stream", "fits", *KINDS, "all", "rms of error/sd", "offset off by, mG", "turned, s")
    lines = ["| " + " | ".join(names) + " |", "|" + "---|" * len(names)]
    for t in tallies:
        if not t.deviations:
            lines.append(f"| {t.cell.rate:g} | {10 * t.cell.noise:g} | - | 0 of {t.unfinished} | | | | | | | |")
            continue
        kinds = " | ".join(f"{100 * t.held(kind):.1f}" for kind in KINDS)
        error = 10.0 * float(np.sqrt(np.mean(np.square(t.offset_errors))))
        left = f" ({t.unfinished} not in time)" if t.unfinished else ""
        lines.append(
            f"| {t.cell.rate:g} | {10 * t.cell.noise:g} | {'whole mG' if t.whole else 'all digits'} | "
            f"{len(t.deviations)}{left} | {kinds} | {100 * t.share:.1f} ± {100 * t.share_sd:.1f} | {t.rms:.2f} | "
            f"{error:.3g} | {float(np.mean(t.seconds)):.0f} |"
        )
    return "\n".join(lines)
