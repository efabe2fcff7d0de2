"""Magnetometer, nine parameters: all directions, +-45 degrees of tilt, outliers, noise above and below a bin; speed."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.accuracy import bounds, peers, scenes
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Settings, Tally, run_case
from bench.accuracy.tables import Part, accuracy_part
from bench.rows import Row, Section, best_of
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.mag import (
    RunningEllipsoid,
    adjusted_least_squares,
    fit_ellipsoid,
    fit_ellipsoid_axis,
    fit_minmax,
    fit_sphere,
)

Array = NDArray[np.float64]

_NINE = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
_STORED = [0, 1, 2, 3, 7, 11, 4, 5, 8]  # offsets, diagonal, upper cross terms of the twelve numbers of a model
CLEAN, SPOILT = 1.05, 1.10

TRUTH = np.concatenate([scenes.OFFSET, scenes.SHAPE[_NINE]])


def stored_truth() -> Array:
    """Offset and correction ``R S^-1``, R the mean radius: what is stored, and its intervals counted."""
    correction = np.cbrt(np.linalg.det(scenes.SHAPE)) * np.linalg.inv(scenes.SHAPE)
    return np.concatenate([scenes.OFFSET, correction[_NINE]])


def ours(fit: Callable[[Any], FitResult]) -> Callable[[Any], Answer | None]:
    """The result of a fit as a row of the tables."""

    def run(samples: Any) -> Answer | None:
        found = fit(samples)
        if found.status == FitStatus.REFUSED:
            return None
        values = np.concatenate([found.native["b"], np.array(found.native["shape"])[_NINE]])
        return Answer(values, found.values[_STORED], found.sd[_STORED])

    return run


def _theirs(fit: Callable[[Array], tuple[Array, Array]]) -> Callable[[Array], Answer | None]:
    def run(samples: Array) -> Answer | None:
        offset, shape = fit(samples.astype(np.float64))
        return Answer(np.concatenate([offset, shape[_NINE]]))

    return run


def _counts(fit: Callable[..., FitResult]) -> Callable[[Any], FitResult]:
    """Milligauss pass as counts: as microtesla their field is none of the Earth's."""
    return lambda samples: fit(samples, unit="counts")


def _running(samples: Array) -> FitResult:
    return (
        RunningEllipsoid.about(samples[:100].mean(axis=0), peers.FIELD).added(samples).fit(unit="counts", quantum=1.0)
    )


def contenders(target: float) -> tuple[list[Contender], list[str]]:
    """Ours, plain forms, and the peers that run here; and why others do not."""

    def fitted(**options: Any) -> Callable[[Any], Answer | None]:
        return ours(lambda samples: fit_ellipsoid(samples, unit="counts", quantum=1.0, **options))

    found = [
        Contender("**mavcal mag-ellipsoid**", fitted(), ours=True, target=target),
        Contender("mavcal, --robust yes", fitted(robust=True), ours=True),
        Contender("mavcal, --model auto", fitted(model="auto"), ours=True),
        Contender("mavcal RunningEllipsoid (ALS)", ours(_running), ours=True),
        Contender("mavcal mag-ellipsoid-axis (S1)", ours(_counts(fit_ellipsoid_axis))),
        Contender("mavcal mag-sphere (S1)", ours(_counts(fit_sphere))),
        Contender("mavcal mag-minmax (S5)", ours(_counts(fit_minmax))),
        Contender("algebraic, ten terms (magcal 'sym')", _theirs(peers.algebraic)),
        Contender("scipy LM, calibrated space", _theirs(peers.calibrated_space)),
    ]
    others, missing = peers_of()
    return [*found, *others], missing


def peers_of() -> tuple[list[Contender], list[str]]:
    """The peers that run here, and why others do not."""
    found, missing = [], []
    sample = scenes.magnetometer(np.random.default_rng(0), scenes.everywhere(np.random.default_rng(1), 300), 3.0, 1.0)
    for name, (distribution, fit) in peers.MAGNETOMETER.items():
        reason = peers.usable(distribution, fit, sample)
        version = peers.version_of(distribution)
        if reason:
            missing.append(f"{name} ({distribution} {version or ''}): {reason}".replace(" )", ")").rstrip("."))
        else:
            found.append(Contender(f"PyPI {name} {version}", _theirs(fit)))
    return found, missing


def _draw(
    directions: Callable[[np.random.Generator], Array], sd: float, quantum: float, outliers: float
) -> Callable[[np.random.Generator], Drawn]:
    variance = bounds.moving_variance_of(sd, quantum)

    def draw(rng: np.random.Generator) -> Drawn:
        u = directions(rng)
        samples = scenes.magnetometer(rng, u, sd, quantum)
        if outliers:
            samples = scenes.with_outliers(rng, samples, outliers, 150.0, quantum)
        information = bounds.ellipsoid(u, scenes.SHAPE, variance)
        return Drawn(samples.astype(np.int16), TRUTH, information, stored_truth())

    return draw


def cases(settings: Settings) -> dict[str, list[Case]]:
    """The cases of every table, by its title."""
    found: dict[str, list[Case]] = {}

    def add(title: str, sizes: list[int], sd: float = 3.0, outliers: float = 0.0, tilt: float | None = None) -> None:
        for n in settings.sizes(sizes):
            seed = settings.seed_of(title, n)
            draw = _draw(
                lambda rng, n=n: scenes.everywhere(rng, n) if tilt is None else scenes.tilted(rng, n, tilt),
                sd,
                1.0,
                outliers,
            )
            found.setdefault(title, []).append(Case(title, n, draw, settings.runs(n), seed))

    decades = [100, 1000, 10_000, 100_000, 1_000_000]
    add("all directions", decades)
    add("tilt up to 45 degrees", decades, tilt=45.0)
    add("all directions, 5 % outliers", decades[1:], outliers=0.05)
    add("all directions, noise of 10", [10_000, 100_000], sd=10.0)
    add("all directions, noise of a fifth of a bin", [1000, 100_000], sd=0.2)
    return found


def run(settings: Settings) -> Iterator[Part]:
    """All tables of the magnetometer."""
    for title, of_title in cases(settings).items():
        found, missing = contenders(SPOILT if "outliers" in title else CLEAN)
        tallies: list[Tally] = []
        for case in of_title:
            settings.say(f"magnetometer, {title}, N = {case.size}, {case.runs} runs, seed {case.seed}")
            tallies += run_case(case, found, settings.budget)
        yield accuracy_part(f"Magnetometer: {title}", tallies, missing)
    yield speed(settings)


def speed(settings: Settings) -> Part:
    """Time and memory at a million samples (quick: fewer), integers and floats."""
    count = settings.largest
    rng = np.random.default_rng(settings.seed_of("speed", count))
    rounded = scenes.magnetometer(rng, scenes.everywhere(rng, count), 3.0, 1.0)
    rows = []
    for samples in (rounded.astype(np.int16), rounded):
        for what, action, limit in (
            ("first fit (ALS)", lambda s=samples: adjusted_least_squares(s), 30.0),
            ("with covariance", lambda s=samples: fit_ellipsoid(s, unit="counts", quantum=1.0), 100.0),
        ):
            taken = 1e3 * best_of(9, action)
            tracemalloc.start()
            action()
            peak = tracemalloc.get_traced_memory()[1] / 1e6
            tracemalloc.stop()
            met = (taken <= limit and peak < 50.0) if count == 1_000_000 else None
            measured = f"{taken:.1f} ms, {peak:.1f} MB above the input"
            rows.append(Row(f"{what}, {samples.dtype}", f"<= {limit:.0f} ms, < 50 MB", measured, met))
    return Part.of_section(Section(f"Magnetometer: time at N = {count}", tuple(rows)))
