"""A flight that stands alone: what holds on every block and along either attitude is told, the rest is one line."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.gap.diagnose import diagnose
from mavcal.calib.gap.effects import by_id
from mavcal.calib.gap.heldout.consistency import along_logged_attitude, confirmed_on_every_block
from mavcal.calib.gap.heldout.gates import Gate
from mavcal.calib.gap.problem import GapProblem, ReferenceInfo, ReferenceKind, Trace
from mavcal.calib.gap.schema import GapReport, GapVerdict
from mavcal.calib.gap_report import verdict_sentence
from mavcal.calib.recording import Sensor
from tests.unit.gap.synthetic import Gap, problem_of

IRON = np.array([6.0, -4.0, 5.0])
ESTIMATOR = ReferenceInfo(ReferenceKind.ESTIMATOR, att_sigma_deg=0.3)


def standing_alone(gap: Gap, tilt_deg: tuple[float, float, float] = (0.2, -0.1, 0.3)) -> GapProblem:
    """One compass with a gap; the attitude that the vehicle logged is `tilt_deg` from the re-estimated one."""
    problem = problem_of(np.random.default_rng(5), (Sensor.MAG,), gap, reference=ESTIMATOR)
    (trace,) = problem.traces
    assert trace.attitude is not None
    body = Rotation.from_quat(trace.attitude[:, [1, 2, 3, 0]])
    logged = (body * Rotation.from_rotvec(np.radians(tilt_deg))).as_quat()[:, [3, 0, 1, 2]]
    flips = np.cumprod(np.append(1.0, np.sign((logged[1:] * logged[:-1]).sum(axis=1))))
    return dataclasses.replace(problem, alone=True, own_attitude=(trace.t, logged * flips[:, None]))


def diagnosed(problem: GapProblem) -> GapReport:
    effects = tuple(by_id()[name] for name in ("mag_hard_iron", "mag_soft_iron", "mag_rotation", "mag_step"))
    return diagnose(problem, effects=effects, nested=False)


def line(report: GapReport) -> str:
    return next((w for w in report.warnings if w.startswith("small, not separable from the reference's error")), "")


def test_ideal_readings_turn_to_the_attitude_that_was_logged() -> None:
    problem = standing_alone(lambda _: 0.0, (0.0, 0.0, 90.0))
    other = along_logged_attitude(problem)
    assert other is not None
    (before,), (after,) = problem.traces, other.traces
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # the body turned by +90 degrees about z
    np.testing.assert_allclose(after.ideal, before.ideal @ quarter.T, atol=1e-6)
    np.testing.assert_array_equal(after.measured, before.measured)
    assert along_logged_attitude(dataclasses.replace(problem, own_attitude=None)) is None


def test_a_magnet_that_is_there_all_the_time_is_told() -> None:
    report = diagnosed(standing_alone(lambda _: IRON))
    assert [e.id for e in report.effects] == ["mag_hard_iron"]
    assert {p.name: p.value for p in report.effects[0].params}["hard_iron.x"] == pytest.approx(IRON[0], abs=0.3)
    assert line(report) == ""


def test_an_effect_holds_on_every_block_or_not_at_all() -> None:
    key = ("mag_soft_iron", (0,))

    def holds(gains: list[float], *, passed: bool | None = True) -> bool:
        return list(confirmed_on_every_block([Gate(key, np.array(gains), passed)])) == [key]

    assert holds([40.0, 25.0, -0.5, 60.0])  # a block in which it hardly shows loses what chance takes
    assert not holds([900.0, 25.0, -40.0, 60.0])  # the sum is far above zero, and one block denies it
    assert not holds([40.0, 25.0, 3.0, 60.0], passed=None)  # of an event no other block can tell
    assert not holds([40.0, 25.0, 3.0, 60.0], passed=False)


@pytest.mark.long
def test_what_is_an_error_of_the_trajectory_is_not_told() -> None:
    """The compass fits the attitude that was logged: only beside the other one is it turned."""
    tilt = np.array([6.0, -4.0, 5.0])

    def turned(trace: Trace) -> np.ndarray:
        return Rotation.from_rotvec(np.radians(tilt)).inv().apply(trace.ideal) - trace.ideal

    alone = standing_alone(turned, tuple(tilt))
    report = diagnosed(alone)
    assert report.effects == ()
    assert "mag_rotation" in line(report)
    assert report.verdict is GapVerdict.REFERENCE
    assert verdict_sentence(report) == "No difference beyond the error of the reference was found."
    beside = diagnosed(dataclasses.replace(alone, alone=False, own_attitude=None))
    assert [e.id for e in beside.effects] == ["mag_rotation"]


def test_a_shape_that_the_trajectory_makes_is_not_told_either() -> None:
    """With no name for what the other attitude takes away, a shape stands for it: a dead travel in white noise."""
    tilt = np.array([6.0, -4.0, 5.0])

    def turned(trace: Trace) -> np.ndarray:
        return Rotation.from_rotvec(np.radians(tilt)).inv().apply(trace.ideal) - trace.ideal

    problem = standing_alone(turned, (6.0, -4.0, 5.0))
    report = diagnose(problem, effects=(by_id()["mag_hard_iron"],), nested=False)
    assert report.effects == ()
    assert not report.unknown.flag
    assert report.verdict is GapVerdict.REFERENCE
