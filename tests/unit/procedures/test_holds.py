"""Holds, steady turns and faces: what is collected tick by tick, and how well it is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder
from mavcal.calib.procedures.base import annotated, mean_or_none, refusals, share_of_information
from mavcal.calib.procedures.holds import LONGEST, SHORTEST, Hold, pose_of_hold
from mavcal.calib.procedures.level import roll_pitch
from mavcal.calib.procedures.motion import RESTING, StillWatch
from mavcal.calib.procedures.poses import DOWN, FACES, down_direction, facing, place
from mavcal.calib.procedures.protocol import Pose, PromptStep
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.procedures.turning import TURNING, Spin, SpinWatch, Turned, way
from mavcal.calib.procedures.turntable import Stretch
from mavcal.calib.recording import Channel, Identity, Sensor, Stage

TICK = 0.25
G = 9.80665
X, Y, Z = np.eye(3)
UNITS = {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.TEMPERATURE: "degC"}


def channel(sensor, k, value, instance=0):
    """Twelve equal samples of tick `k`."""
    t = k * TICK + np.arange(12) * TICK / 12.0
    return Channel(sensor, instance, t, np.tile(value, (12, 1)), UNITS[sensor], Stage.RAW, "S")


def frame(k, *, accel=None, gyro=None, warmth=None, instance=0):
    given_ = ((Sensor.ACCEL, accel), (Sensor.GYRO, gyro), (Sensor.TEMPERATURE, warmth))
    return {
        (sensor, instance): channel(sensor, k, np.atleast_1d(value), instance)
        for sensor, value in given_
        if value is not None
    }


def held(lengths, *, seconds=TICK, **more):
    """A hold of ticks whose specific force has these lengths."""
    hold = Hold()
    for k, length in enumerate(lengths):
        hold.add(frame(k, accel=[0.0, 0.0, -length], **more), seconds)
    return hold


# -- holds ---------------------------------------------------------------------------------------------------------


def test_the_last_tick_of_a_hold_may_belong_to_the_movement_after_it():
    hold = held([G] * 9 + [30.0])
    assert hold.seconds == 9 * TICK
    assert len(hold.channel(Sensor.ACCEL, 0)) == 9 * 12
    assert hold.mean(0).mean == pytest.approx([0.0, 0.0, -G])


def test_the_error_of_a_hold_is_that_of_the_mean_of_its_ticks():
    lengths = np.array([9.8, 9.9, 9.7, 9.8, 10.0, 9.6])
    assert held([*lengths, 0.0]).error == pytest.approx(lengths.std(ddof=1) / math.sqrt(6.0))


def test_four_ticks_are_needed_to_know_an_error():
    assert held([G] * 4).error == math.inf  # three of them are kept
    assert held([G] * 5).error < math.inf
    assert Hold().error == math.inf


def test_the_worst_accelerometer_counts():
    hold = Hold()
    for k in range(7):
        shaken = 0.1 * (-1.0) ** k
        hold.add({**frame(k, accel=G * Z), **frame(k, accel=(G + shaken) * Z, instance=1)}, TICK)
    assert hold.error == pytest.approx(0.1 * math.sqrt(6.0 / 5.0) / math.sqrt(6.0))


@pytest.mark.long
@pytest.mark.parametrize(
    ("ticks", "scatter", "goal", "complete"),
    [
        (8, 0.0, 0.01, False),  # 1.75 s
        (9, 0.0, 0.01, True),
        (9, 0.1, 0.01, False),
        (9, 0.1, 0.1, True),
        (80, 0.3, 0.01, False),
        (81, 0.3, 0.01, True),  # nobody holds a pose for longer
    ],
)
def test_a_hold_ends_with_its_goal_after_two_seconds_or_after_twenty(ticks, scatter, goal, complete):
    assert (SHORTEST, LONGEST) == (2.0, 20.0)
    assert held([G + scatter * (-1.0) ** k for k in range(ticks)]).complete(goal) is complete


@pytest.mark.parametrize(("deg", "crept"), [(7.9, False), (8.1, True)])
def test_a_hold_whose_direction_creeps_is_another_pose(deg, crept):
    turned = Rotation.from_euler("x", deg, degrees=True).apply(Z)
    assert Hold(Z).crept(turned) is crept
    assert not Hold().crept(turned)


def test_a_hold_knows_the_temperature_of_its_unit_where_it_streams():
    assert held([G] * 6, warmth=31.0).temperature(0) == 31.0
    assert held([G] * 6).temperature(0) is None
    assert held([G] * 6).mean(1) is None
    assert held([G] * 6).channel(Sensor.GYRO, 0) is None


def test_a_pose_is_taken_of_the_accelerometers_that_gave_samples():
    pose = pose_of_hold(held([G] * 9), 3, Pose.LEVEL, Z, (0, 1))
    assert list(pose.means) == [0]
    assert (pose.number, pose.pose) == (3, Pose.LEVEL)


# -- turning -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deg_per_s", "steady"),
    [
        ((0.0, 0.0, 4.9), False),
        ((0.0, 0.0, 5.1), True),
        ((0.0, 0.0, -5.1), True),
        ((4.9, 0.0, 10.0), True),  # a hand's wobble
        ((5.1, 0.0, 10.0), False),
        ((24.9, 0.0, 100.0), True),  # a quarter of a fast turn
        ((18.0, 18.0, 100.0), False),
    ],
)
def test_a_steady_turn_goes_about_one_axis(deg_per_s, steady):
    spin = Spin(np.radians(deg_per_s), TICK)
    assert spin.steady_about(Z) is steady
    assert spin.steady_about(-Z) is steady
    assert spin.about(-Z) == -spin.about(Z)


def watched(rates, *, body=None, resting=True):
    watch = SpinWatch({0: np.eye(3) if body is None else body})
    spins = [watch.update(frame(k, gyro=rate), (0,), TICK, resting=resting) for k, rate in enumerate(rates)]
    return watch, spins


def test_the_offset_at_rest_is_taken_off_a_turn():
    bias = np.array([0.01, -0.02, 0.005])
    watch, _ = watched([bias] * 5)
    spin = watch.update(frame(6, gyro=bias + Z), (0,), TICK, resting=False)
    assert spin.rate == pytest.approx(Z)
    assert watch.offset == pytest.approx(np.linalg.norm(bias))


def test_a_rate_is_that_of_the_body():
    turned = Rotation.from_euler("z", 90.0, degrees=True).as_matrix()
    assert watched([X], body=turned, resting=False)[1][0].rate == pytest.approx(Y)


def test_a_push_while_at_rest_does_not_move_the_offset():
    watch, _ = watched([0.0 * X, 0.0 * X, 0.6 * TURNING * X, 0.4 * TURNING * X])
    assert watch.offset == pytest.approx(0.4 * TURNING / 3.0)


def test_before_any_rest_no_offset_is_known():
    watch, (spin,) = watched([Z], resting=False)
    assert (watch.rested, watch.offset) == (False, 0.0)
    assert spin.rate == pytest.approx(Z)
    assert watch.update({}, (0,), TICK, resting=True) is None
    assert watched([0.0 * X])[0].rested


def test_a_way_to_turn_has_its_vector_and_its_name():
    assert [Turned(axis, sign).name for axis, sign in ((0, 1.0), (1, -1.0))] == ["x+", "y-"]
    assert Turned(1, -1.0).vector.tolist() == [0.0, -1.0, 0.0]


def test_seen_from_above_a_turn_about_what_points_down_is_clockwise():
    assert way(Z, Z) == "clockwise"  # level, to the right
    assert way(-Z, Z) == "counter-clockwise"  # on its back
    assert way(X, -X) == "counter-clockwise"


# -- stretches -----------------------------------------------------------------------------------------------------


def stretch_of(rates_deg):
    stretch = Stretch(Z)
    for k, rate in enumerate(np.radians(rates_deg)):
        stretch.add(frame(k, gyro=rate * Z, warmth=20.0 + k), Spin(rate * Z, TICK))
    return stretch


def test_a_stretch_leaves_out_its_run_up_and_the_tick_before_its_end():
    stretch = stretch_of([10.0, 30.0, *[90.0] * 6, 50.0])
    assert stretch.seconds == 6 * TICK
    assert np.degrees(stretch.channel(0).values[:, 2]) == pytest.approx(np.full(72, 90.0))
    assert stretch.temperature(0) == 20.0 + np.mean(np.arange(2, 8))
    assert stretch.channel(1) is None


def test_the_error_of_a_stretch_is_that_of_its_mean_rate():
    rates = np.array([89.0, 91.0, 90.0, 92.0])
    found = stretch_of([0.0, 0.0, 0.0, *rates])  # the tick that is held back gives its rate later
    assert found.error == pytest.approx(np.radians(rates.std(ddof=1)) / 2.0)
    assert stretch_of([0.0, 0.0, 0.0, 90.0, 90.0, 90.0]).error == math.inf


@pytest.mark.parametrize(
    ("before", "now", "on"),
    [
        (100.0, 105.2, True),
        (100.0, 105.4, False),
        (100.0, 94.8, False),
        (10.0, 10.9, True),
        (10.0, 11.1, False),
        (0.0, -0.9, True),
    ],
)
def test_a_tick_that_turns_otherwise_belongs_to_another_stretch(before, now, on):
    """By a twentieth of its rate, or a degree a second."""
    stretch = stretch_of([before])
    assert stretch.goes_on(Spin(np.radians(now) * Z, TICK)) is on
    assert Stretch(Z).goes_on(Spin(np.radians(now) * Z, TICK))


# -- faces ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize(("deg", "square"), [(11.9, True), (12.1, False)])
def test_a_face_is_square_within_twelve_degrees(face, deg, square):
    down = np.array(DOWN[face])
    across = np.cross(down, [0.36, 0.48, 0.8])
    turn = Rotation.from_rotvec(np.radians(deg) * across / np.linalg.norm(across))
    found = facing(turn.apply(down))
    assert (found.face, found.square) == (face, square)
    assert math.degrees(found.off) == pytest.approx(deg)


def test_down_is_what_the_first_accelerometer_shows_that_is_not_weightless():
    watch = StillWatch(RESTING, ((Sensor.ACCEL, 0), (Sensor.ACCEL, 1)))
    body = {0: np.eye(3), 1: Rotation.from_euler("x", 90.0, degrees=True).as_matrix()}
    watch.update({**frame(0, accel=-0.9 * Z), **frame(0, accel=-G * Z, instance=1)})
    assert down_direction(watch, body, (0,)) is None
    assert down_direction(watch, body, (0, 1)) == pytest.approx(body[1] @ Z)
    watch.update(frame(1, accel=-1.1 * X))
    assert down_direction(watch, body, (0, 1)) == pytest.approx(X)
    assert down_direction(watch, body, (1,)) is None


def test_a_prompt_to_put_it_down_leaves_the_choice_while_there_is_one():
    prompt = place((Pose.LEFT, Pose.BACK), "Good. ", suffix=" on the table")
    assert (
        prompt.text == "Good. Put the vehicle down square on its left side, on its back, in any order on the table, "
        "and let go."
    )
    assert (prompt.step, prompt.pose, prompt.remaining) == (PromptStep.PLACE, Pose.LEFT, (Pose.LEFT, Pose.BACK))
    assert place((Pose.BACK,), "").text == "Put the vehicle down square on its back, and let go."


@given(roll=st.floats(-179.0, 179.0), pitch=st.floats(-89.0, 89.0), yaw=st.floats(-180.0, 180.0))
def test_roll_and_pitch_are_those_of_the_attitude_whatever_the_heading(roll, pitch, yaw):
    attitude = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    found = roll_pitch(attitude.inv().apply([0.0, 0.0, -G]))
    assert np.degrees(found) == pytest.approx((roll, pitch), abs=1e-6)


# -- frames, options, results --------------------------------------------------------------------------------------


ARDUPILOT = Identity(autopilot="ardupilot")
PARAMETERS = {f"INS_ACCOFFS_{a}": 0.5 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.1 for a in "XYZ"}


def context(parameters, identity=ARDUPILOT):
    return ProcedureContext(identity=identity, parameters=parameters)


def test_what_parameters_say_is_in_force_is_believed_and_silence_is_none():
    told = PARAMETERS | {"AHRS_ORIENTATION": 2, "INS_TCAL1_ENABLE": 0}  # yaw 90
    known = context(told)
    assert known.body_from_sensor(Sensor.ACCEL, 0) @ X == pytest.approx(Y)
    assert np.linalg.norm(known.in_force(Sensor.ACCEL, 0).apply(np.full(3, 0.5))) == pytest.approx(0.0, abs=1e-9)
    assert known.in_force(Sensor.ACCEL, 0).apply(0.5 + X) == pytest.approx(1.1 * Y)


@pytest.mark.parametrize("unknown", [context({}), context({"X": 1.0}, Identity(autopilot="other"))])
def test_without_parameters_or_of_an_unknown_autopilot_nothing_is_in_force(unknown):
    assert unknown.body_from_sensor(Sensor.ACCEL, 0).tolist() == np.eye(3).tolist()
    assert unknown.in_force(Sensor.ACCEL, 0).apply(X) == pytest.approx(X)


def test_parameters_that_do_not_say_are_told_from_none_at_all():
    broken = context({"AHRS_ORIENTATION": 999, **PARAMETERS})
    assert broken.in_force(Sensor.ACCEL, 0) is None
    assert broken.body_from_sensor(Sensor.ACCEL, 0).tolist() == np.eye(3).tolist()


@pytest.mark.parametrize("kind", sorted(PROCEDURES))
def test_an_option_that_a_procedure_does_not_have_is_named_with_those_it_has(kind):
    spec = PROCEDURES[kind]
    with pytest.raises(InvalidInputError, match=f"{kind} has no option colour, size; its options are: ") as raised:
        spec.validated({"size": 1, "colour": 2})
    assert all(option.name in str(raised.value) for option in spec.options)
    given = {option.name: option.low for option in spec.options if option.default is None}
    options = spec.validated(given)
    assert dict(options) == {option.name: given.get(option.name, option.default) for option in spec.options}
    with pytest.raises(TypeError):
        options["uncertainty"] = 1.0


def test_warnings_of_a_capture_are_added_once_and_mark_it_relative():
    made = FitBuilder("test", Sensor.GYRO, 0, "rad/s", 10).refused("no")
    noted = annotated(annotated(made, context({}), ["a", "b"]), context(PARAMETERS), ["b", "c"])
    assert noted.warnings == ("a", "b", "c")
    assert noted.relative  # once unknown, it stays so
    assert not annotated(made, context(PARAMETERS), []).relative


@pytest.mark.parametrize(("reached", "share"), [(math.inf, 0.0), (0.0, 0.0), (0.2, 25.0), (0.1, 100.0), (0.05, 100.0)])
def test_the_share_of_information_goes_with_the_square(reached, share):
    assert share_of_information(0.1, reached) == pytest.approx(share)


def test_refusals_name_their_sensor():
    fits = [FitBuilder("test", sensor, i, "1", 10).refused("no") for sensor, i in ((Sensor.GYRO, 0), (Sensor.MAG, 1))]
    assert refusals(fits) == "gyro 1: no; compass 2: no"
    assert refusals([]) == "no sensor is left"
    assert mean_or_none([]) is None
    assert mean_or_none([1.0, 4.0]) == 2.5
