"""Magnetometer through the whole method: poses with and without time, and movements, all directions and +-45 degrees.

``python -m bench.accuracy order``. The other tables call the fit alone, on samples without time. Here the same samples
come as a recording, as `mavcal fit mag-ellipsoid` reads them, so what a time stamp leads to is measured as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from bench.accuracy import bounds, scenes
from bench.accuracy.campaign import Answer, Case, Contender, Drawn, Tally, run_case
from bench.accuracy.rows_mag import TRUTH, ours, peers_of, stored_truth
from bench.accuracy.settings import Settings
from bench.accuracy.tables import Part, accuracy_part
from mavcal.calib.logs.tables import NO_TIME
from mavcal.calib.methods import METHODS
from mavcal.calib.recording import Channel, Event, Recording, Sensor, Stage

Array = NDArray[np.float64]

SD = 3.0
"""mG, without rounding."""
SIZES = [100, 300, 1000, 3000, 10_000]
TARGET = 1.2
"""Largest error over the bound."""
TURN_S = 60.0
"""Length of a movement, however many samples it has: of few the vehicle turns by 45 degrees from each to the next."""
_SLOW = np.array([0.19, 0.31, 0.23])  # Hz, of pitch, roll and heading
_FULL = 180.0  # deg of roll and pitch that reach every direction


def moved(rng: np.random.Generator, t: Array, limit_deg: float) -> Array:
    """Field (N, 3) of unit length in a vehicle that turns smoothly, roll and pitch within `limit_deg`."""
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    swing = np.sin(2.0 * np.pi * _SLOW * t[:, None] + phase)
    roll, pitch = np.radians(limit_deg) * swing[:, 0], np.radians(limit_deg) * swing[:, 1]
    yaw = 2.0 * np.pi * _SLOW[2] * t / 3.0 + np.pi * swing[:, 2]
    return scenes.seen_from(yaw, pitch, roll, scenes.DIP)[0]


def recording(samples: Array, step: float | None) -> Recording:
    """Samples as a table of them is read; `step` s apart, None: without a column of time."""
    t = np.arange(len(samples)) * (1.0 if step is None else step)
    said = () if step is not None else (Event(0.0, NO_TIME, "rows are counted"),)
    return Recording((Channel(Sensor.MAG, 0, t, 0.1 * samples, "uT", Stage.RAW, "table"),), events=said)


def _scaled(answer: Answer | None) -> Answer | None:
    """From uT to mG; the matrix has no unit."""
    if answer is None or answer.stored is None or answer.stored_sd is None:
        return answer
    factor = np.array([10.0] * 3 + [1.0] * 6)
    return Answer(10.0 * answer.values, factor * answer.stored, factor * answer.stored_sd)


def _by_method(data: Recording) -> Answer | None:
    return _scaled(ours(lambda read: METHODS["mag-ellipsoid"].run(read)[0])(data))


def contenders(settings: Settings) -> tuple[list[Contender], list[str]]:
    """The method, and the peers on the same samples where they are wanted."""
    peers, missing = ([], []) if settings.alone else peers_of()

    def of_samples(fit: Callable[[Array], Answer | None]) -> Callable[[Recording], Answer | None]:
        return lambda data: fit(10.0 * data.channel(Sensor.MAG, 0).values)

    own = Contender("**mavcal fit mag-ellipsoid**", _by_method, ours=True, target=TARGET)
    return [own, *(Contender(peer.name, of_samples(peer.fit)) for peer in peers)], missing


def _draw(n: int, tilt: float | None, step: float | None, moving: bool) -> Callable[[np.random.Generator], Drawn]:
    def draw(rng: np.random.Generator) -> Drawn:
        apart = TURN_S / n if moving else step
        if moving:
            u = moved(rng, np.arange(n) * TURN_S / n, _FULL if tilt is None else tilt)
        else:
            u = scenes.everywhere(rng, n) if tilt is None else scenes.tilted(rng, n, tilt)
        samples = scenes.magnetometer(rng, u, SD, 0.0)
        return Drawn(recording(samples, apart), TRUTH, bounds.ellipsoid(u, scenes.SHAPE, SD**2), stored_truth())

    return draw


def cases(settings: Settings) -> dict[str, list[Case]]:
    """The cases of every table, by its title."""
    found: dict[str, list[Case]] = {}
    for what, step, moving in (
        ("poses without time", None, False),
        ("poses every 0.1 s", 0.1, False),
        ("poses every 5 s", 5.0, False),
        (f"a movement of {TURN_S:.0f} s", None, True),
    ):
        for where, tilt in (("all directions", None), ("tilt up to 45 degrees", 45.0)):
            title = f"{what}, {where}"
            for n in settings.sizes(SIZES):
                draw = _draw(n, tilt, step, moving)
                found.setdefault(title, []).append(Case(title, n, draw, settings.runs(n), settings.seed_of(title, n)))
    return found


def run(settings: Settings) -> Iterator[Part]:
    """All tables."""
    found, missing = contenders(settings)
    for title, of_title in cases(settings).items():
        tallies: list[Tally] = []
        for case in of_title:
            settings.say(f"magnetometer, {title}, N = {case.size}, {case.runs} runs, seed {case.seed}")
            tallies += run_case(case, found, settings.budget)
        yield accuracy_part(f"Magnetometer by the method: {title}", tallies, missing)
