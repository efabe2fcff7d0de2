"""Which pose, turn or temperature is wished for, with distances worked out by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.names import ardupilot_imu_names
from mavcal.calib.firmware.plan import Change, ParameterKind, ParameterVerdict, ProofVerdict
from mavcal.calib.firmware.proof.check import check_stream
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import force_of
from mavcal.calib.firmware.proof.verify import movement_for
from mavcal.calib.recording import Sensor

G = 9.80665
ACCEL, GYRO, MAG = (Subject(s, 0) for s in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG))
LEVEL = (0.0, 0.0, -G)


def verdict(name, found=ProofVerdict.NOT_OBSERVABLE, *, acts=True):
    return ParameterVerdict(name, found, 0.0, 0.0, "", "", acts_on_stream=acts)


def reading(mean, sd, *, temperature=32.0, rest=0):
    return StillMean(5.0, np.array(mean, dtype=np.float64), sd**2 * np.eye(3), temperature, rest=rest)


def checked(about, parameters, changes, fit, readings, *, before=()):
    """The check of one sensor with `changes` (old, new) by name."""
    planned = tuple(Change(name, old, new, ParameterKind.REAL32, "") for name, (old, new) in changes.items())
    force = force_of("ardupilot", parameters, planned)
    pair = None if fit is None else Pair(about, fit, None)
    then, now = (
        StreamEvidence({about: tuple(before)}, {}, frozenset()),
        StreamEvidence({about: tuple(readings)}, {}, frozenset()),
    )
    check = check_stream(about, tuple(changes), force, pair, then, now, restarted=False)
    assert check is not None
    return check


def wished(check, *names, about=ACCEL):
    return movement_for([verdict(n) for n in names or check.names], {about: check})


SCALES = {f"INS_ACCSCAL_{a}": (1.0, 1.01) for a in "XYZ"}


@pytest.fixture
def accel(ardupilot_parameters, make_fit):
    def make(sd, *poses, changes=SCALES):
        matrix = np.diag([changes.get(f"INS_ACCSCAL_{a}", (1.0, 1.0))[1] for a in "XYZ"])
        fit = make_fit(Sensor.ACCEL, matrix=matrix, offset_sd=0.0)
        return checked(ACCEL, ardupilot_parameters, changes, fit, [reading(p, sd) for p in poses or [LEVEL]])

    return make


@pytest.mark.parametrize(("distance", "faces"), [(5.02, ("nose_down", "left")), (4.98, ())])
def test_a_pose_is_worth_five_standard_deviations(accel, distance, faces):
    # one per cent of gravity, seen with the scatter of the mean and the stability of the sensor
    check = accel(np.sqrt((0.01 * G / distance) ** 2 - 1e-6))
    found = wished(check, "INS_ACCSCAL_X", "INS_ACCSCAL_Y")
    assert (() if found is None else found.faces) == faces
    if found:
        assert found.text == "Hold it still nose down, then on its left side"
        assert (found.turn, found.temperature) == (False, None)


def test_a_pose_that_was_shown_is_not_wished_for_again(accel):
    down, left = (-G, 0.0, 0.0), (0.0, G, 0.0)
    assert wished(accel(0.003, LEVEL, left), "INS_ACCSCAL_X", "INS_ACCSCAL_Y").faces == ("nose_down", "right")
    assert wished(accel(0.003, down), "INS_ACCSCAL_X").faces == ("nose_up",)
    for degrees, faces in ((13.0, ("nose_up",)), (15.0, ("nose_down",))):  # oblique from 14 degrees on
        tilt = np.radians(degrees)
        oblique = (-G * np.cos(tilt), 0.0, -G * np.sin(tilt))
        assert wished(accel(0.003, oblique), "INS_ACCSCAL_X").faces == faces


def test_one_pose_serves_all_that_it_shows(accel):
    changes = {"INS_ACCSCAL_X": (1.0, 1.01), "INS_ACCOFFS_X": (0.0, 0.2), "INS_ACCOFFS_Y": (0.0, 0.2)}
    assert wished(accel(0.003, changes=changes)).faces == ("nose_down", "left")


def test_all_six_poses_shown_leave_nothing_to_wish(accel):
    poses = [tuple(G * sign * row) for row in np.eye(3) for sign in (1.0, -1.0)]
    assert wished(accel(0.003, *poses)) is None


def test_only_what_is_open_and_acts_counts(accel):
    check = accel(0.003)
    for found, acts in (
        (ProofVerdict.PROVED, True),
        (ProofVerdict.CONTRADICTED, True),
        (ProofVerdict.CONSISTENT, False),
    ):
        assert movement_for([verdict("INS_ACCSCAL_X", found, acts=acts)], {ACCEL: check}) is None
    assert movement_for([verdict("INS_ACCSCAL_X", ProofVerdict.CONSISTENT)], {ACCEL: check}).faces == ("nose_down",)


def test_a_sensor_that_was_not_seen_needs_a_rest_and_the_others_their_poses(accel):
    found = movement_for([verdict("COMPASS_OFS_X"), verdict("INS_ACCSCAL_X")], {ACCEL: accel(0.003)})
    assert found.text == "Hold the vehicle still for five seconds; hold it still nose down"
    alone = movement_for([verdict("COMPASS_OFS_X")], {})
    assert (alone.text, alone.faces, alone.turn) == ("Hold the vehicle still for five seconds", (), False)
    assert movement_for([], {}) is None


def test_without_a_fit_no_pose_is_promised(accel, ardupilot_parameters):
    blind = checked(
        GYRO,
        ardupilot_parameters,
        {"INS_GYROFFS_X": (0.0, 1e-5)},
        None,
        [reading((0, 0, 0), 1e-3)],
        before=[reading((0, 0, 0), 1e-3)],
    )
    settled = accel(0.003)
    order = {
        GYRO: blind,
        Subject(Sensor.ACCEL, 1): settled,
        ACCEL: accel(0.003, changes={"INS_ACCSCAL_X": (1.0, 1.01)}),
    }
    found = movement_for([verdict("INS_GYROFFS_X"), verdict("INS_ACCSCAL_X")], order)
    assert found.faces == ("nose_down",)
    later = movement_for([verdict("INS_ACCSCAL_Z")], {GYRO: blind, ACCEL: settled})
    assert later.faces == ("back",)


@pytest.mark.parametrize(("new", "turn"), [(1.02, True), (1.0005, False)])
def test_a_compass_is_turned_where_that_shows_its_matrix(ardupilot_parameters, make_fit, new, turn):
    changes = {"COMPASS_DIA_X": (1.0, new)}
    fit = make_fit(Sensor.MAG, matrix=np.diag([new, 1, 1]), offset_sd=0.0, quality={"radius": 50.0, "field_ratio": 1.0})
    parameters = ardupilot_parameters | {"COMPASS_DIA_Y": 1.0, "COMPASS_DIA_Z": 1.0}
    check = checked(MAG, parameters, changes, fit, [reading((0.0, 30.0, 40.0), 0.2)])
    found = wished(check, about=MAG)
    assert (found is not None) == turn
    if found:
        assert (found.turn, found.text) == (True, "Turn the vehicle slowly through all directions")
        assert movement_for([verdict("COMPASS_DIA_X")], {MAG: check, Subject(Sensor.MAG, 1): check}).turn


@pytest.mark.parametrize(("share", "turn"), [(1.01, True), (0.99, False)])
def test_a_turn_is_worth_five_standard_deviations_over_its_26_directions(ardupilot_parameters, make_fit, share, turn):
    """A scale of x that is off by e shows e 50 cos^2 along every direction."""
    corners = [np.array(c) - 1.0 for c in np.ndindex(3, 3, 3) if c != (1, 1, 1)]
    weight = np.sqrt(sum((c[0] ** 2 / (c @ c)) ** 2 for c in corners))
    error = share * 5.0 * 0.5 / (50.0 * weight)
    sd = np.sqrt(0.5**2 - 0.05**2)
    fit = make_fit(Sensor.MAG, offset_sd=0.0, matrix=np.diag([1.0 + error, 1, 1]))
    fit = dataclasses.replace(fit, quality={"radius": 50.0, "field_ratio": 1.0})
    check = checked(
        MAG, ardupilot_parameters, {"COMPASS_DIA_X": (1.0, 1.0 + error)}, fit, [reading((0.0, 30.0, 40.0), sd)]
    )
    found = wished(check, about=MAG)
    assert (found is not None) == turn


class TestTemperature:
    """A gyroscope whose polynomial holds from 10 to 60 degC about 35."""

    def check(self, parameters, changes, *heats, low=10.0, high=60.0, about=GYRO):
        names = ardupilot_imu_names(Sensor.GYRO, about.instance)
        row = {names["thermal_enable"]: 1, names["thermal_min"]: low, names["thermal_max"]: high}
        row |= {names[f"thermal_{k}_{a}"]: 0.0 for k in (1, 2, 3) for a in "xyz"} | {names["temperature"]: 35.0}
        seen = [reading((0, 0, 0), 1e-3, temperature=heat) for heat in heats]
        changes = {names[role]: values for role, values in changes.items()}
        return checked(about, parameters | row, changes, None, seen, before=seen[:1])

    @pytest.mark.parametrize(
        ("heats", "wish"),
        [((20.0,), 55.0), ((50.0,), 15.0), ((16.0, 50.0), None), ((16.0, 48.9), 55.0), ((16.0, 49.1), None)],
    )
    def test_the_farther_end_is_wished_for_unless_it_was_near(self, ardupilot_parameters, heats, wish):
        check = self.check(ardupilot_parameters, {"thermal_1_x": (0.0, 1.0)}, *heats)
        found = wished(check, about=GYRO)
        assert (None if found is None else found.temperature) == (None if wish is None else pytest.approx(wish))
        if wish:
            assert found.text == f"Leave it alone until its sensors are at about {wish:.0f} degC"

    @pytest.mark.parametrize(
        ("changes", "thermal"),
        [
            ({"offset_x": (0.0, 1e-6)}, False),
            ({"thermal_2_y": (0.0, 1e-3)}, True),  # alike at both ends of the range, and not between them
            ({"thermal_1_z": (0.0, 1e-3)}, True),
            ({"thermal_enable": (0, 1), "thermal_1_x": (0.0, 1e-3)}, True),
        ],
    )
    def test_only_what_depends_on_temperature_asks_for_one(self, ardupilot_parameters, changes, thermal):
        check = self.check(ardupilot_parameters, changes, 20.0)
        found = wished(check, check.names[0], about=GYRO)
        assert (found is not None) == thermal

    def test_the_first_sensor_says_which(self, ardupilot_parameters):
        second = Subject(Sensor.GYRO, 1)
        checks = {
            GYRO: self.check(ardupilot_parameters, {"thermal_1_x": (0.0, 1.0)}, 20.0),
            second: self.check(
                ardupilot_parameters, {"thermal_1_x": (0.0, 1.0)}, 70.0, low=50.0, high=80.0, about=second
            ),
        }
        names = [name for check in checks.values() for name in check.names]
        assert movement_for([verdict(n) for n in names], checks).temperature == pytest.approx(55.0)
        assert movement_for([verdict(names[1])], checks).temperature == pytest.approx(53.0)
