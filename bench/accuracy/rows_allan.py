"""Allan deviation: the same numbers as allantools, and how long they take."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import numpy as np

from bench.accuracy import peers
from bench.accuracy.campaign import Settings
from bench.accuracy.tables import Part
from bench.rows import Row, Section, beside, best_of
from mavcal.calib.noise.allan import octaves, overlapping_deviation

RATE = 100.0


def run(settings: Settings) -> Iterator[Part]:
    """Octave averaging times of white noise with a walk."""
    count = settings.largest
    rng = np.random.default_rng(settings.seed_of("allan", count))
    y = rng.normal(size=count) + np.cumsum(rng.normal(size=count)) * 1e-3
    m = octaves(count)
    if peers.version_of("allantools") is None:
        own = 1e3 * best_of(5, lambda: overlapping_deviation(y, RATE, m))
        yield Part.of_section(
            Section("Allan deviation, allantools not installed", (Row("mavcal", "", f"{own:.0f} ms"),))
        )
        return
    allantools = importlib.import_module("allantools")

    def theirs() -> tuple[np.ndarray, np.ndarray]:
        found = allantools.oadev(y, rate=RATE, data_type="freq", taus=m / RATE)
        return found[0], found[1]

    taus, deviation = theirs()
    table = overlapping_deviation(y, RATE, np.round(taus * RATE).astype(np.intp))
    apart = float(np.abs(table.adev / deviation - 1.0).max())
    rows = (
        beside(f"octaves of {count} samples", lambda: overlapping_deviation(y, RATE, m), theirs, 1.0),
        Row("largest difference, relative", "<= 1e-9", f"{apart:.1e}", apart <= 1e-9),
    )
    title = f"Allan deviation beside PyPI allantools {peers.version_of('allantools')} oadev"
    yield Part.of_section(Section(title, rows))
