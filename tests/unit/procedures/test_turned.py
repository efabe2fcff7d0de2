"""Jobs of a vehicle that is turned: turntable, thread, poses with the movements between."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import ProcedureError
from mavcal.calib.fit import FitStatus
from mavcal.calib.procedures.poses import APART, angle, suggest
from mavcal.calib.procedures.protocol import Done, GaveUp, Prompt
from mavcal.calib.procedures.registry import create, replay
from mavcal.calib.procedures.spec import OperatorAnswer, ProcedureContext
from mavcal.calib.recording import Identity, Sensor

from .conftest import FACES, MAG, Bench, Truth, attitude

CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0})
SKEW = np.array([[1.01, 0.004, -0.003], [0.002, 0.985, 0.005], [-0.001, 0.003, 1.02]])
GYRO = Truth((0.0132, -0.0084, 0.0057), SKEW, noise=0.001)
UP = {"level": [0, 0, 1.0], "right": [0, 1.0, 0], "nose_down": [1.0, 0, 0]}


def on_table(bench, faces=UP, rate=45.0, rest=8.0):
    bench.hold(rest)
    for face in faces:
        axis = np.array(UP[face])
        bench.hold(3.0, attitude(*FACES[face])).turn(10.0, rate * axis).hold(1.0).turn(10.0, -rate * axis).hold(1.0)
    return bench


def on_thread(bench, ways=(1, -1, 1, -1), turns=3.0, rate=90.0):
    bench.hold(6.0)
    for way in ways:
        bench.turn(360.0 * turns / rate, [0, 0, way * rate]).hold(4.0)
    return bench


def run(kind, bench, answers=(), **options):
    procedure = create(kind, options, CONTEXT)
    procedure.schedule([OperatorAnswer(t, value) for t, value in answers])
    steps = [*procedure.feed(bench.record()), *procedure.end()]
    return procedure.outcome, [s for s in steps if isinstance(s, Prompt)]


def known_to(fit):
    error = fit.values - np.concatenate([GYRO.offset, np.linalg.inv(SKEW).ravel()])
    return np.abs(error / fit.sd)


# -- turntable ---------------------------------------------------------------------------------------------------------


def test_a_turntable_gives_scale_cross_axes_and_offset():
    outcome, prompts = run("gyro-turntable", on_table(Bench(seed=4, gyros=(GYRO,))), [(104.0, "45")])
    assert isinstance(outcome, Done), outcome
    (fit,) = outcome.results
    assert (known_to(fit) < 4.5).all()
    assert 100.0 * fit.sd[[3, 7, 11]].max() <= 0.1
    assert fit.quality["turns"] == 7  # with the rest
    asked = [p for p in prompts if p.number is not None]
    assert asked[0].number.name == "rate"
    assert prompts.index(asked[-1]) < prompts.index(next(p for p in prompts if p.step == "turn"))
    assert {p.axis for p in prompts if p.step == "turn"} == {
        tuple(float(s * v) + 0.0 for v in axis) for axis in UP.values() for s in (1, -1)
    }


def test_the_rate_may_be_an_option_and_one_axis_alone_be_turned():
    bench = on_table(Bench(gyros=(GYRO,)), ["level"])
    outcome, prompts = run("gyro-turntable", bench, rate=45.0, x=False, y=False)
    (fit,) = outcome.results
    assert fit.status == FitStatus.PARTIAL
    assert not any(p.number for p in prompts)
    assert "about x" in fit.movements["matrix_xx"]
    assert abs(fit.model.matrix[2, 2] - np.linalg.inv(SKEW)[2, 2]) < 4.0 * fit.sd[11] + 1e-4
    nothing, _ = run("gyro-turntable", bench, rate=45.0, x=False, y=False, z=False)
    assert "no axis" in nothing.cause


def test_a_rate_that_is_not_the_stated_one_is_no_turn():
    outcome, prompts = run("gyro-turntable", on_table(Bench(gyros=(GYRO,))), rate=120.0)
    assert isinstance(outcome, GaveUp)
    assert " z+" in outcome.cause
    assert any(" 120 deg/s" in p.text for p in prompts)


def test_an_uncertain_rate_allows_no_more():
    outcome, _ = run("gyro-turntable", on_table(Bench(gyros=(GYRO,))), rate=45.0, rate_sd=0.5)
    assert isinstance(outcome, GaveUp)
    assert "uncertainty" in outcome.cause


def test_a_table_that_turns_during_the_rest_is_not_believed():
    bench = Bench(gyros=(GYRO,)).turn(8.0, [0, 0, 10.0])
    outcome, _ = run("gyro-turntable", on_table(bench, rest=0.5), rate=45.0)
    assert isinstance(outcome, GaveUp), outcome.because


def test_only_a_number_within_limits_is_an_answer():
    procedure = create("gyro-turntable", {}, CONTEXT)
    procedure.feed(Bench(gyros=(GYRO,)).hold(4.0).record())
    for wrong in ("fast", "nan", "0", "-45", "1e9", "finish"):
        with pytest.raises(ProcedureError, match="a number from 1 to 1000 deg/s"):
            procedure.answer(wrong)
    assert procedure.answer("45.5") == ()


# -- thread ------------------------------------------------------------------------------------------------------------


def test_a_compass_counts_the_turns_of_a_thread():
    outcome, prompts = run("gyro-thread", on_thread(Bench(seed=4, gyros=(GYRO,), mags=(MAG,))), turns=3.0)
    (fit,) = outcome.results
    assert fit.status == FitStatus.PARTIAL
    assert abs(fit.model.offset[2] - GYRO.offset[2]) < 4.0 * fit.sd[2]
    assert abs(fit.model.matrix[2, 2] - np.linalg.inv(SKEW)[2, 2]) < 4.0 * fit.sd[11] + 1e-4
    assert [p.axis[2] for p in prompts if p.step == "turn" and not p.stable][:2] == [1.0, -1.0]
    assert all(p.turns == 3.0 for p in prompts if p.step == "turn")


def test_without_a_compass_the_number_is_asked_for_and_replayed():
    bench = on_thread(Bench(gyros=(GYRO,), mags=()), (1, -1, 1, -1, 1)).hold(6.0)
    live = create("gyro-thread", {"angle_sd": 0.5}, CONTEXT)
    steps = list(live.feed(bench.record()))
    assert [s.number.name for s in steps if isinstance(s, Prompt) and s.number] == ["turns"]
    at = live.time
    live.answer("3")
    (fit,) = live.outcome.results
    assert abs(fit.model.matrix[2, 2] - np.linalg.inv(SKEW)[2, 2]) < 4.0 * fit.sd[11] + 1e-4
    again = replay("gyro-thread", {"angle_sd": 0.5}, CONTEXT, bench.record(), [OperatorAnswer(at, "3")])
    np.testing.assert_array_equal(again.results[0].values, fit.values)
    never = replay("gyro-thread", {}, CONTEXT, bench.record())
    assert "the number of turns was not stated" in never.cause


def test_turns_that_go_back_before_the_rest_do_not_count():
    bench = Bench(gyros=(GYRO,)).hold(6.0).turn(12.0, [0, 0, 90.0]).turn(6.0, [0, 0, -90.0]).hold(4.0)
    outcome, prompts = run("gyro-thread", on_thread(bench))
    assert any("turned back before it came to rest" in p.text for p in prompts)
    assert isinstance(outcome, Done), outcome


def test_a_slow_steady_turn_is_no_rest():
    bench = Bench(gyros=(GYRO,)).hold(6.0).turn(360.0 / 8.0, [0, 0, 8.0]).turn(2.0, [0, 0, 6.0])
    outcome, _ = run("gyro-thread", bench)
    assert isinstance(outcome, GaveUp)
    assert " 0 times" in outcome.cause


# -- poses and movements -----------------------------------------------------------------------------------------------


def held(seed=3):
    cross = np.array([[1.02, 0.004, -0.003], [0.004, 0.985, 0.002], [-0.003, 0.002, 1.01]])
    bench = Bench(seed=seed, accels=(Truth((0.31, -0.22, 0.17), cross, noise=0.02),), gyros=(GYRO,)).hold(9.0)
    rng = np.random.default_rng(1)
    obliques = [(35, 20), (-50, 40), (-140, 30), (45, -40), (140, 35), (130, -40), (-30, -45)]
    for roll, pitch in [*((e[0], e[1]) for e in FACES.values()), *obliques]:
        bench.hold(4.0, attitude(roll, pitch, rng.uniform(-180.0, 180.0)), tremor=0.25)
    return bench


def test_poses_and_movements_give_both_sensors():
    bench = held()
    outcome, prompts = run("imu-multi", bench)
    accel, gyro = outcome.results
    assert (accel.sensor, gyro.sensor) == (Sensor.ACCEL, Sensor.GYRO)
    assert (np.abs(accel.model.offset - bench.accels[0].offset) < 4.5 * accel.sd[:3]).all()
    diagonal = np.diag(np.linalg.inv(SKEW))
    assert (np.abs(np.diag(gyro.model.matrix) - diagonal) < 4.5 * gyro.sd[[3, 7, 11]]).all()
    assert (np.abs(gyro.model.offset - GYRO.offset) < 4.5 * gyro.sd[:3]).all()
    assert gyro.sd[:3].max() < np.radians(0.01)  # from the rest: a hand's tremor knows it ten times worse
    assert prompts[0].step == "place"
    assert {p.step for p in prompts} == {"place", "pose"}


def test_without_a_rest_there_is_no_beginning():
    outcome, _ = run("imu-multi", Bench().hold(60.0, tremor=2.0), patience=30.0)
    assert isinstance(outcome, GaveUp)
    assert "no rest" in outcome.cause
    assert " 30 s" in outcome.cause


def test_a_suggested_pose_is_never_one_that_was_taken():
    rng = np.random.default_rng(3)
    taken = [np.array(v, dtype=float) for v in UP.values()]
    for _ in range(12):
        wish = Rotation.from_rotvec(np.radians(4.0) * rng.standard_normal(3)).apply(suggest(taken))
        assert all(angle(wish, t) > 0.6 * APART for t in taken)
        taken.append(wish)
