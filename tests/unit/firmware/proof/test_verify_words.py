"""What the physical check says of a parameter, and how far the vehicle's level may be off."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.compose.draft import Subject
from mavcal.calib.firmware.compose.fitted import Pair
from mavcal.calib.firmware.compose.plan import compose
from mavcal.calib.firmware.compose.trim import force_when_level
from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, ProofVerdict, SensorVerdict, WritePlan
from mavcal.calib.firmware.proof.check import Corrections, StreamCheck, check_stream, out_of_range, within
from mavcal.calib.firmware.proof.evidence import StillMean, StreamEvidence
from mavcal.calib.firmware.proof.force import force_of
from mavcal.calib.firmware.proof.level_check import level_checks
from mavcal.calib.firmware.proof.verify import verify
from mavcal.calib.geometry import quaternion_from_euler
from mavcal.calib.recording import Channel, ParameterTimeline, Recording, Sensor, Stage
from mavcal.calib.triad import ThermalPolynomial, TriadModel

from .test_verify import LEVEL, gyro_case, stream

GYRO, ACCEL, MAG = (Subject(s, 0) for s in (Sensor.GYRO, Sensor.ACCEL, Sensor.MAG))
X = "INS_GYROFFS_X"
BEFORE_AND_AFTER = "the streams before and after"
LENGTH = "the length of its vector at rest"


@pytest.fixture
def case(ardupilot_parameters, ardupilot_fingerprint, make_fit):
    sensors, fits, plan = gyro_case(make_fit, ardupilot_parameters, ardupilot_fingerprint, [0.01, -0.02, 0.0002])
    return sensors, fits, plan, ardupilot_parameters


def said(case, *, before=True, applied=True, fits=True, sensors=None, later=None, **more):
    """Texts and verdicts by name."""
    truth, found, plan, parameters = case
    now = parameters | {c.name: c.new for c in plan.changes}
    rng = np.random.default_rng(1)
    earlier = stream(rng, truth, parameters) if before else None
    after = stream(rng, sensors or truth, now if applied else parameters, start=10.0, **more)
    result = verify(plan, found if fits else [], earlier, later or after, parameters=now)
    return {p.name: (p.verdict, p.text, p.acts_on_stream) for p in result.parameters}, result


@pytest.mark.parametrize(("before", "by"), [(True, BEFORE_AND_AFTER), (False, LENGTH)])
def test_each_verdict_has_its_sentence(case, before, by):
    found, result = said(case, before=before)
    assert found[X] == (ProofVerdict.PROVED, f"{by} agree with the new value and contradict the old one", True)
    small = found["INS_GYROFFS_Z"]
    assert small == (
        ProofVerdict.NOT_OBSERVABLE,
        f"its effect is below 3 standard deviations of {by} in these attitudes",
        True,
    )
    assert found["INS_GYR1_CALTEMP"][1:] == ("no stream depends on it; it was read back", False)
    assert result.unseen == ()
    refused, _ = said(case, before=before, applied=False)
    assert refused[X] == (ProofVerdict.CONTRADICTED, f"{by} behave as if the old value were still in force", True)
    other, wrong = said(case, before=before, sensors={Sensor.GYRO: TriadModel([0.3, -0.2, 0.1])})
    assert other[X][1].endswith("; they scatter more than noise and fit explain")
    assert wrong.contradicted == ()
    assert "gyro 1 reads" in wrong.must_go


def test_what_was_not_seen_says_why(case):
    _, _, _, parameters = case
    accel = stream(np.random.default_rng(2), {Sensor.ACCEL: TriadModel()}, parameters, start=10.0)
    found, result = said(case, later=accel)
    assert found[X] == (ProofVerdict.NOT_OBSERVABLE, "gyro 1 was not streamed after the write", True)
    assert found["INS_GYR1_CALTEMP"][2] is False
    assert X in result.unseen
    assert "INS_GYR1_CALTEMP" not in result.unseen
    short, result = said(case, hold=0.3)
    assert short[X] == (ProofVerdict.NOT_OBSERVABLE, "the vehicle was not still long enough to read gyro 1", True)
    assert X in result.unseen
    blind, result = said(case, before=False, fits=False)
    assert blind[X][1].startswith("gyro 1 was moved between the captures, or its temperature was not streamed")
    assert result.unseen == ()


def test_a_raw_stream_does_not_depend_on_what_is_written(case):
    _, _, _, parameters = case
    whole = stream(np.random.default_rng(2), {Sensor.GYRO: TriadModel()}, parameters, start=10.0)
    raw = dataclasses.replace(
        whole,
        channels=tuple(dataclasses.replace(c, stage=Stage.RAW) for c in whole.channels),
    )
    found, _ = said(case, later=raw)
    verdict, text, acts_on_stream = found[X]
    assert (verdict, acts_on_stream) == (ProofVerdict.NOT_OBSERVABLE, False)
    assert "raw" in text


def test_parameters_come_from_the_recordings_and_the_later_ones_count(case):
    sensors, fits, plan, parameters = case
    now = parameters | {c.name: c.new for c in plan.changes}
    rng = np.random.default_rng(1)
    before, after = stream(rng, sensors, parameters), stream(rng, sensors, now, start=10.0)
    assert verify(plan, fits, before, after).proved is False  # Z is too small to tell
    assert not verify(plan, fits, before, after).contradicted
    nothing = dataclasses.replace(after, parameters=ParameterTimeline(()))
    assert not verify(plan, fits, before, nothing).contradicted
    with pytest.raises(InvalidInputError, match="needs the vehicle's parameters"):
        verify(plan, fits, None, nothing)


CURVE = ThermalPolynomial(25.0, 10.0, 60.0, [[1e-4, 0.0], [0.0, 1e-6], [0.0, 0.0]])


def reading(temperature, mean=(0.0, 0.0, 0.0), **more):
    return StillMean(5.0, np.array(mean), 1e-8 * np.eye(3), temperature, rest=0, **more)


class TestRange:
    @pytest.mark.parametrize(("heat", "kept"), [(9.6, False), (9.8, True), (60.2, True), (60.4, False), (None, True)])
    def test_a_drift_is_known_a_third_of_a_degree_beyond_its_range(self, heat, kept):
        assert (within(CURVE, (reading(heat),)) != ()) == kept
        assert len(within(None, (reading(heat),))) == 1

    @pytest.mark.parametrize(
        ("heats", "words"),
        [
            (
                (70.0, 75.25),
                "gyro 1 is at 75.2 degC and its drift is known from 10 to 60 degC: it will be provable below 60 degC",
            ),
            (
                (5.0,),
                "gyro 1 is at 5.0 degC and its drift is known from 10 to 60 degC: it will be provable above 10 degC",
            ),
            ((5.0, 30.0), ""),
            ((None,), ""),
            ((), ""),
        ],
    )
    def test_where_it_will_be_provable_is_said(self, ardupilot_parameters, make_fit, heats, words):
        force = force_of("ardupilot", ardupilot_parameters, ())
        now = StreamEvidence({GYRO: tuple(reading(h) for h in heats)}, {}, frozenset())
        pair = Pair(GYRO, None, make_fit(Sensor.GYRO, polynomial=CURVE))
        assert out_of_range(GYRO, force, pair, now) == words
        assert out_of_range(GYRO, force, None, now) == ""


class TestCheck:
    def check(self, parameters, fit, changes, now, before=()):
        planned = tuple(Change(n, old, new, ParameterKind.REAL32, "") for n, (old, new) in changes.items())
        force = force_of("ardupilot", parameters, planned)
        about = Subject(fit.sensor, fit.instance)
        then, seen = (StreamEvidence({about: tuple(rs)}, {}, frozenset()) for rs in (before, now))
        found = check_stream(about, tuple(changes), force, Pair(about, fit, None), then, seen, restarted=False)
        assert isinstance(found, StreamCheck)
        return found

    def test_the_effect_of_one_value_is_how_far_the_stream_would_be_off(self, ardupilot_parameters, make_fit):
        fit = make_fit(Sensor.ACCEL, matrix=np.diag([1.02, 1, 1]), offset=[0.3, 0, 0], offset_sd=0.0)
        changes = {"INS_ACCSCAL_X": (1.0, 1.02), "INS_ACCOFFS_X": (0.1, 0.3)}
        poses = [reading(32.0, (0, 0, -9.8)), dataclasses.replace(reading(32.0, (-9.8, 0.0, 0.0)), rest=1)]
        check = self.check(ardupilot_parameters, fit, changes, poses)
        assert check.effect("INS_ACCSCAL_X") == pytest.approx(9.8 - 9.8 / 1.02)
        assert check.effect("INS_ACCOFFS_X") == pytest.approx(1.02 * 0.2)
        assert check.unit == "m/s2"
        sd = check.sd("INS_ACCSCAL_X")
        assert sd == pytest.approx(check.effect("INS_ACCSCAL_X") / check.judgement.distance["INS_ACCSCAL_X"])

    def test_a_value_without_an_effect_has_the_scatter_of_the_check(self, ardupilot_parameters, make_fit):
        fit = make_fit(Sensor.ACCEL, offset_sd=0.0)
        check = self.check(ardupilot_parameters, fit, {"INS_ACCOFFS_X": (0.25, 0.25)}, [reading(32.0, (0, 0, -9.8))])
        assert check.effect("INS_ACCOFFS_X") == 0.0
        assert check.sd("INS_ACCOFFS_X") == pytest.approx(np.sqrt(1e-8 + 1e-6))

    def test_motors_are_taken_off_the_stream_and_put_on_again(self, ardupilot_parameters):
        known = ardupilot_parameters | {"COMPASS_MOTCT": 2, "COMPASS_MOT_X": 50.0}
        corrections = Corrections(force_of("ardupilot", known, ()), MAG)
        now = [reading(None, (30.0, 0.0, 40.0), current=2.0)]
        raw = corrections.raw(frozenset(), now)
        np.testing.assert_allclose(raw, [[20.0, 0.0, 40.0]])
        np.testing.assert_allclose(corrections.stream(frozenset(), raw, now), [[30.0, 0.0, 40.0]])

    @pytest.mark.parametrize(
        ("quality", "length"),
        [({"radius": 60.0, "field_ratio": 1.2}, 50.0), ({"radius": 60.0}, None), ({"field_ratio": 1.2}, None)],
    )
    def test_a_field_s_strength_is_known_where_the_fit_knew_it(self, ardupilot_parameters, make_fit, quality, length):
        fit = make_fit(Sensor.MAG, quality=quality)
        check = self.check(ardupilot_parameters, fit, {"COMPASS_OFS_X": (0.0, 1.0)}, [reading(None, (30.0, 0.0, 40.0))])
        assert check.capture.expected.magnitude == (None if length is None else pytest.approx(length))
        assert (check.unit, check.equality) == ("uT", False)


class TestLevel:
    """Readings without noise: down leans by acos(cos roll cos pitch)."""

    ANGLES = np.radians((1.7, -2.3))

    def checks(self, make_fit, autopilot, *, off=(0.0, 0.0), lag=0.0, stands=ANGLES, spread=(3e-4, 4e-4), rows=9):
        """A board that stands at `stands`; the trim is wrong by `off`, the attitude of the estimator by `lag`, rad."""
        native = dict(zip(("roll", "pitch", "roll_sd", "pitch_sd"), (*self.ANGLES, *spread), strict=True))
        fit = make_fit(Sensor.ACCEL, method="level", native=native)
        other = make_fit(Sensor.ACCEL, 1, method="level", native=native)
        trim = dict(zip(("AHRS_TRIM_X", "AHRS_TRIM_Y"), self.ANGLES + np.array(off), strict=True))
        force = force_of(autopilot, trim | self.calibration(autopilot), ())
        now = StreamEvidence(
            {ACCEL: (StillMean(5.0, force_when_level(*stands), 1e-8 * np.eye(3), 32.0, rest=0),)}, {}, frozenset()
        )
        t = np.linspace(4.0, 5.9, rows)
        q = quaternion_from_euler(*(np.full(rows, a) for a in (-off[0] + lag, -off[1], 0.7)))
        after = Recording((Channel(Sensor.ATTITUDE, 0, t, q, "1", Stage.RAW, "ATTITUDE"),))
        plan = WritePlan(Fingerprint(autopilot, "", "", ()), "", ())
        _, found = level_checks(
            plan, [other, fit], force, before=None, after=after, then=StreamEvidence({}, {}, frozenset()), now=now
        )
        return found

    def judged(self, make_fit, autopilot, **more):
        return self.checks(make_fit, autopilot, **more)[0]

    @staticmethod
    def calibration(autopilot):
        if autopilot == "ardupilot":
            row = {f"INS_ACCOFFS_{a}": 0.0 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.0 for a in "XYZ"}
            return row | {"AHRS_ORIENTATION": 0, "INS_ACC_ID": 5}
        row = {f"CAL_ACC0_{a}OFF": 0.0 for a in "XYZ"} | {f"CAL_ACC0_{a}SCALE": 1.0 for a in "XYZ"}
        board = {"SENS_BOARD_ROT": 0} | {f"SENS_BOARD_{a}_OFF": 0.0 for a in "XYZ"}
        return row | board | {"CAL_ACC0_ID": 5, "CAL_ACC0_ROT": -1}

    @pytest.mark.parametrize(("roll", "pitch"), [(0.1, 0.0), (0.0, -0.2), (0.1, 0.2), (-0.2, 0.1)])
    def test_ardupilot_s_level_is_its_accelerometer_s_through_the_trim(self, make_fit, roll, pitch):
        off = np.arccos(np.cos(np.radians(roll)) * np.cos(np.radians(pitch)))
        check = self.judged(make_fit, "ardupilot", off=np.radians((roll, pitch)))
        assert check.value == pytest.approx(off, rel=1e-2)
        limit = np.radians(0.2) + 5.0 * 5e-4
        assert (check.limit, check.sd) == (pytest.approx(limit), pytest.approx(5e-4))
        assert (check.verdict, check.instance, check.unit) == (SensorVerdict.RIGHT, 0, "rad")
        assert check.text == (
            f"the vehicle reads {np.degrees(check.value):.2f} deg off level where its level was measured; "
            f"the limit is {np.degrees(limit):.2f} deg"
        )

    def test_beyond_its_limit_it_is_wrong(self, make_fit):
        for degrees, verdict in ((0.34, "right"), (0.35, "wrong")):
            check = self.judged(make_fit, "ardupilot", off=(np.radians(degrees), 0.0))
            assert check.verdict == verdict
        assert check.text.endswith("; at most 0.34 deg")

    @pytest.mark.parametrize(("apart", "seen"), [(0.29, True), (0.31, False)])
    def test_only_the_pose_in_which_it_was_measured_counts(self, make_fit, apart, seen):
        check = self.judged(make_fit, "ardupilot", stands=self.ANGLES + np.radians((apart, 0.0)))
        assert (check.value is not None) == seen
        if not seen:
            assert (check.limit, check.sd, check.verdict) == (None, None, SensorVerdict.NOT_OBSERVABLE)
            assert check.text.startswith("the vehicle stands otherwise than when its level was measured,")

    @pytest.mark.parametrize(("lag", "verdict"), [(0.49, "right"), (0.51, "not_observable"), (20.0, "not_observable")])
    def test_an_attitude_beside_its_accelerometer_is_left_open(self, make_fit, lag, verdict):
        level, attitude = self.checks(make_fit, "ardupilot", lag=np.radians(lag))
        assert level.verdict == SensorVerdict.RIGHT
        assert attitude.verdict == verdict
        assert attitude.value == pytest.approx(np.radians(lag), rel=1e-2)

    @pytest.mark.parametrize(("rows", "seen"), [(3, 1), (4, 2)])
    def test_a_mean_needs_four_attitudes(self, make_fit, rows, seen):
        assert len(self.checks(make_fit, "ardupilot", rows=rows)) == seen

    def test_px4_s_level_is_its_accelerometer_s(self, make_fit):
        check = self.judged(make_fit, "px4")
        lean = np.arccos(np.cos(self.ANGLES[0]) * np.cos(self.ANGLES[1]))
        assert check.value == pytest.approx(lean)
        assert check.limit == pytest.approx(np.radians(0.2) + 5.0 * 5e-4)

    def test_without_a_level_job_there_is_nothing_to_check(self, ardupilot_parameters):
        plan = WritePlan(Fingerprint("ardupilot", "", "", ()), "", ())
        nothing = StreamEvidence({}, {}, frozenset())
        force = force_of("ardupilot", ardupilot_parameters, ())
        assert level_checks(plan, [], force, before=None, after=Recording(()), then=nothing, now=nothing) == ({}, ())


def test_two_sensors_on_the_same_vehicle_are_checked_each_by_itself(
    ardupilot_parameters, ardupilot_fingerprint, make_fit
):
    """A sensor that nothing of the plan acts on does not end the list."""
    truth = {Sensor.ACCEL: TriadModel(), Sensor.GYRO: TriadModel([0.01, 0, 0])}
    fits = [make_fit(Sensor.ACCEL, offset=[0, 0, 0]), make_fit(Sensor.GYRO, offset=[0.01, 0, 0], offset_sd=2e-5)]
    plan = compose(fits[1:], ardupilot_parameters, ardupilot_fingerprint)
    rng = np.random.default_rng(0)
    now = ardupilot_parameters | {c.name: c.new for c in plan.changes}
    before = stream(rng, truth, ardupilot_parameters, (LEVEL,))
    after = stream(rng, truth, now, (LEVEL,), start=10.0)
    result = verify(plan, fits, before, after, parameters=now)
    assert {p.name: p.verdict for p in result.parameters}[X] == ProofVerdict.PROVED
