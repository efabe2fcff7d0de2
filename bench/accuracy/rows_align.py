"""Magnetometer against accelerometer: mounting angle and offset, against the joint bound of both sensors' noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.accuracy import bounds, peers, scenes
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, run_case
from bench.accuracy.tables import Part, accuracy_part
from bench.rows import Row, Section, best_of
from mavcal.calib.fit import FitStatus
from mavcal.calib.mag.align import Vertical, fit_alignment

Array = NDArray[np.float64]

MOUNTING = Rotation.from_rotvec(np.radians([3.0, -2.0, 4.0])).as_matrix()
MATRIX = scenes.SHAPE @ MOUNTING
MAG_SD, DOWN_SD, QUANTUM = 3.0, 0.005, 1.0
TARGET = 1.10


@dataclass(frozen=True, eq=False)
class Both:
    """Samples of a magnetometer (mgauss) and of an accelerometer (g), (N, 3) each, at the same times."""

    t: Array
    field: Array
    force: Array


def _read(rng: np.random.Generator, fields: Array, downs: Array) -> Both:
    samples = fields @ MATRIX.T + scenes.OFFSET + MAG_SD * rng.normal(size=fields.shape)
    force = -downs + DOWN_SD * rng.normal(size=downs.shape)
    return Both(np.arange(len(fields)) / 50.0, np.rint(samples), np.rint(force / 1e-3) * 1e-3)


def _attitudes(rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Unit field and unit vertical (count, 3) in the body, every attitude as likely."""
    downs = scenes.everywhere(rng, count)
    across = np.cross(downs, scenes.everywhere(rng, count))
    across /= np.linalg.norm(across, axis=1)[:, None]
    return np.sin(scenes.DIP) * downs + np.cos(scenes.DIP) * across, downs


def _values(offset: Array, matrix: Array, which: str) -> Array:
    """Offset, or the small rotation (rad) by which the mounting of `matrix` is off."""
    if which == "offset":
        return offset
    values, vectors = np.linalg.eigh(matrix @ matrix.T)
    found = (vectors / np.sqrt(values)) @ vectors.T @ matrix
    return Rotation.from_matrix(found @ MOUNTING.T).as_rotvec()


def _ours(which: str) -> Callable[[Both], Answer | None]:
    def run(data: Both) -> Answer | None:
        found = fit_alignment(
            data.t, data.field, Vertical(data.t, data.force, gravity=1.0), time_offset=0.0, unit="counts", quantum=1.0
        )
        if found.status != FitStatus.OK:
            return None
        truth = np.linalg.inv(MATRIX)
        truth = truth / np.cbrt(np.linalg.det(truth))
        values = _values(found.model.offset, np.linalg.inv(found.model.matrix), which)
        if which == "offset":
            return Answer(values, found.values[:3], found.sd[:3])
        # The stored matrix less its truth: its intervals are counted about zero.
        return Answer(values, (found.model.matrix - truth).ravel(), found.sd[3:])

    return run


def _two_stage(which: str) -> Callable[[Both], Answer | None]:
    """Algebraic ellipsoid, then the rotation with the steadiest dip."""

    def run(data: Both) -> Answer | None:
        offset, shape = peers.algebraic(data.field)
        return Answer(_values(offset, peers.rotated(shape, offset, data.field, -data.force), which))

    return run


def _derivative(which: str) -> Array:
    """(3, 12) of those values by offset and rows of M."""
    truth = np.concatenate([scenes.OFFSET, MATRIX.ravel()])
    step, rows = 1e-5, []
    for k in range(12):
        up, down = (truth + s * np.eye(12)[k] for s in (step, -step))
        ahead, behind = (_values(v[:3], v[3:].reshape(3, 3), which) for v in (up, down))
        rows.append((ahead - behind) / (2.0 * step))
    return np.column_stack(rows)


def _draw(count: int, which: str) -> Callable[[np.random.Generator], Drawn]:
    derivative = _derivative(which)
    truth = scenes.OFFSET if which == "offset" else np.zeros(3)
    stored = scenes.OFFSET if which == "offset" else np.zeros(9)
    variances = bounds.variance_of(MAG_SD, QUANTUM), bounds.variance_of(DOWN_SD, 1e-3)

    def draw(rng: np.random.Generator) -> Drawn:
        fields, downs = _attitudes(rng, count)
        whole = np.linalg.inv(bounds.alignment(fields, downs, MATRIX, scenes.DIP, *variances))
        information = np.linalg.inv(derivative @ whole[:12, :12] @ derivative.T)
        return Drawn(_read(rng, fields, downs), truth, information, stored)

    return draw


def run(settings: Settings) -> Iterator[Part]:
    """Angle and offset in separate tables, and the time of it."""
    for which in ("mounting angle", "offset"):
        title = f"Alignment with the accelerometer: {which}"
        contenders = [
            Contender("**mavcal mag-align**", _ours(which), ours=True, target=TARGET, exact=False),
            Contender("algebraic ellipsoid, then rotation", _two_stage(which)),
        ]
        tallies = []
        for count in settings.sizes([200, 2000, 20_000]):
            runs = settings.runs(count) if count < 20_000 else 60
            case = Case(title, count, _draw(count, which), runs, settings.seed_of("alignment", count))
            settings.say(f"{title}, N = {count}, {case.runs} runs, seed {case.seed}")
            tallies += run_case(case, contenders, settings.budget)
        yield accuracy_part(title, tallies)
    rng = np.random.default_rng(settings.seed_of("alignment time", 2000))
    data = _read(rng, *_attitudes(rng, 2000))
    run_once = _ours("offset")
    taken = 1e3 * best_of(7, lambda: run_once(data))
    row = Row("N = 2000", "<= 10 ms", f"{taken:.1f} ms", None if settings.quick else taken <= 10.0)
    yield Part.of_section(Section("Alignment: time", (row,), ("Processor time, best of seven.",)))
