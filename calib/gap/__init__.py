"""The sim-to-real gap: where a real sensor differs from the simulated one, why, and how far an effect closes it.

The reference (:mod:`calib.gap.reference`) makes a :class:`calib.gap.problem.GapProblem` of recordings: every sensor
beside what an ideal one would have read. In the diagnosis (:mod:`calib.gap.diagnose`) the effects of
:mod:`calib.gap.effects` compete. It answers with a :class:`calib.gap.schema.GapReport`. The export
(:mod:`calib.gap.export`) writes effects for simulators. The function :func:`run` does all of it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from mavcal.calib.airframe.answer import AirframePart
from mavcal.calib.airframe.diagnose import airframe_alone, airframe_gap
from mavcal.calib.airframe.effects import IDS as AIRFRAME_IDS
from mavcal.calib.airframe.found import AirframeAnswer, NoAirframe
from mavcal.calib.errors import IncomparableError, InvalidInputError
from mavcal.calib.gap.cleaned import without_matrix_errors
from mavcal.calib.gap.companion.baselines import problem_of
from mavcal.calib.gap.diagnose import diagnose, untestable
from mavcal.calib.gap.effects import catalogue
from mavcal.calib.gap.export import with_patches
from mavcal.calib.gap.joined import joined
from mavcal.calib.gap.problem import Trace
from mavcal.calib.gap.progress import DEFAULT_LIMIT_S, GapPace, GapProgress, GapStage, unsearched
from mavcal.calib.gap.reference.estimator import estimator_error
from mavcal.calib.gap.remembered import one_diagnosis
from mavcal.calib.gap.schema import GapReport, as_json
from mavcal.calib.gap.witness import of_no_sensor
from mavcal.calib.recording import Recording, Sensor

__all__ = [
    "DEFAULT_LIMIT_S",
    "GapPace",
    "GapProgress",
    "GapReport",
    "GapStage",
    "as_json",
    "diagnose",
    "run",
    "simulator_of",
]

_NO_SIMULATOR = NoAirframe("one flight alone shows no gap of its airframe", "a flight of the simulator, as --sim")
_MOVING = 2.0
"""Speed, m/s, above which a vehicle counts as moving. Chosen, not measured: an estimator at rest stays far below."""


@one_diagnosis()
def run(
    real: Recording,
    sim: Recording | None = None,
    nominal: Sequence[Recording] = (),
    *,
    without: Sequence[str] = (),
    alpha: float = 0.005,
    nested: bool = True,
    inputs: Mapping[str, str] | None = None,
    pace: GapPace | None = None,
    frame: str | None = None,
    sim_frame: Mapping[str, Any] | None = None,
    mass: float | None = None,
) -> GapReport:
    """The gap between a real recording and its reference: sensors, and airframe and air if both recordings fly.

    Parameters
    ----------
    real
        The recording whose gap is asked for.
    sim
        A simulator's recording of the same trajectory, or of another flight of the same kind.
    nominal
        Recordings without an effect: the noise is learned from them. What the first shows against its pose is
        subtracted.
    without
        Ids of effects that are left out of the catalogue.
    alpha
        Chance that anything is reported where there is no gap.
    nested
        Whether the shrink repeats the selection inside the folds.
    inputs
        sha256 of the files, by role (``real``, ``sim``), for the report.
    pace
        Time limit and progress listener; None: no limit.
    frame
        A frame of :data:`calib.airframe.geometry.NAMED` for recordings that do not say theirs.
    sim_frame
        Settings of the frame with which the simulator flew, for the remedy; None: its own defaults.
    mass
        Of the real vehicle, kg, for the remedy; None: not known.

    Raises
    ------
    InvalidInputError
        If the recordings have nothing in common or are of different vehicles, or `without` names an effect that does
        not exist.
    """
    effects = catalogue()
    if unknown_ids := sorted(set(without) - {effect.id for effect in effects} - AIRFRAME_IDS):
        raise InvalidInputError(f"no such effect in the catalogue: {', '.join(unknown_ids)}")
    selected = tuple(effect for effect in effects if effect.id not in without)
    pace = pace or GapPace()
    flown: AirframeAnswer | NoAirframe | None = None
    companion: tuple[Trace, ...] = ()
    if sim is not None and _is_flight(real):
        pace.begin(GapStage.AIRFRAME)
        flown = airframe_gap(real, sim, without=without, frame=frame, ended=pace.ends, estimator=estimator_error)
    pace.begin(GapStage.REFERENCE)
    digests = dict(inputs or {})
    try:
        problem = dataclasses.replace(problem_of(real, sim, nominal, alpha, pace), inputs=digests)
        flies = flown is not None or (sim is None and _is_flight(real))
        foreign = partial(of_no_sensor, real=real, sim=sim) if flies else (lambda _: ())
        companion = problem.companion
        report = diagnose(problem, effects=selected, alpha=alpha, nested=nested, pace=pace, foreign=foreign)
    except IncomparableError as error:
        report = untestable(error.reason, error.need, digests)
    if flown is not None and sim is not None:
        sensors, report = report, joined(report, flown, real, sim, companion)
        if isinstance(flown, AirframeAnswer) and (right := without_matrix_errors(real, report)) is not None:
            # a search cut short would take names away
            flown = airframe_gap(right, sim, without=without, frame=frame, estimator=estimator_error)
            report = joined(sensors, flown, real, sim, companion)
        report = unsearched(report, pace)
    elif sim is None and _is_flight(real):
        alone = airframe_alone(real, frame=frame, estimator=estimator_error(real))
        report = joined(report, alone if isinstance(alone, NoAirframe) else _NO_SIMULATOR, real)
        if isinstance(alone, AirframePart):
            report = dataclasses.replace(report, airframe=alone)
    base, vehicle = simulator_of(real, sim), real.parameters.final()
    return with_patches(report, base, frame=sim_frame, mass=mass, vehicle=vehicle)


def simulator_of(real: Recording, sim: Recording | None) -> Mapping[str, float]:
    """Parameters of the recorded simulator: ArduPilot's ``SIM_*`` or PX4's ``SIH_*``; empty if none was recorded."""
    found = (r.parameters.final() for r in (sim, real) if r is not None)
    return next((p for p in found if any(name.startswith(("SIM_", "SIH_")) for name in p)), {})


def _is_flight(recording: Recording) -> bool:
    """Whether the recording may be of a flight: its motors were commanded, or it was armed, or it moved."""
    told = any(c.sensor == Sensor.MOTOR and c.values.any() for c in recording.channels)
    moved = any(c.sensor == Sensor.VELOCITY and np.abs(c.values).max(initial=0.0) > _MOVING for c in recording.dynamics)
    armed = any(event.kind == "armed" for event in recording.events)
    return told or moved or armed or any(c.sensor == Sensor.CONTROL for c in recording.dynamics)
