"""Jobs of a vehicle that is put down on its faces: one axis, six faces, six rings."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mavcal.calib.earth import EarthField
from mavcal.calib.procedures.protocol import Done, GaveUp, Pose, Prompt
from mavcal.calib.procedures.registry import create
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity, Sensor
from tests.fields import field_of

from .conftest import FACES, FIELD, MAG, Bench, Truth, attitude

CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0}, earth_field=EarthField(FIELD))
DOWN = dict(zip(FACES, np.array([[0, 0, 1], [0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1]]), strict=True))
CROSS = np.array([[1.02, 0.004, -0.003], [0.002, 0.985, 0.005], [-0.004, 0.003, 1.01]])
YAW_45 = Rotation.from_euler("Z", 45.0, degrees=True).as_matrix()


def ardupilot(**parameters):
    known = {f"INS_ACCOFFS_{a}": 0.0 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.0 for a in "XYZ"}
    known |= {"AHRS_ORIENTATION": 0, "INS_TCAL1_ENABLE": 0} | parameters
    return replace(CONTEXT, identity=Identity(autopilot="ardupilot"), parameters=known)


def run(kind, bench, context=CONTEXT, **options):
    procedure = create(kind, options, context)
    steps = [*procedure.feed(bench.record()), *procedure.end()]
    return procedure.outcome, [s for s in steps if isinstance(s, Prompt)]


def on_faces(bench, tilt=0.0, seconds=5.0, faces=FACES):
    rng = np.random.default_rng(7)
    for face in faces:
        askew = Rotation.from_rotvec(np.radians(tilt) * rng.standard_normal(3))
        bench.hold(seconds, attitude(*FACES[face]) * askew)
    return bench


def turned(bench, faces=FACES, rate=45.0, seconds=10.0):
    for face in faces:
        bench.hold(3.0, attitude(*FACES[face])).turn(seconds, rate * DOWN[face])
    return bench


def known_to(fit, truth, correction=None):
    expected = np.linalg.inv(truth.sensitivity) if correction is None else correction
    error = fit.values - np.concatenate([truth.offset, expected.ravel()])
    return np.abs(error / fit.sd)


# -- one axis ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("face", ["level", "right"])
def test_one_axis_gives_the_offset_of_the_scale_in_force(face):
    truth = Truth((0.31, -0.22, 0.17), np.diag([1 / 1.02, 1 / 0.985, 1 / 1.01]), noise=0.02)
    scales = {"INS_ACCSCAL_X": 1.02, "INS_ACCSCAL_Y": 0.985, "INS_ACCSCAL_Z": 1.01}
    bench = Bench(seed=3, accels=(truth,)).hold(10.0, attitude(*FACES[face]))
    outcome, prompts = run("accel-one-axis", bench, ardupilot(**scales), fixture_sd=0.0)
    (fit,) = outcome.results
    assert (np.abs(fit.model.offset - truth.offset) < 4.0 * fit.sd[:3]).all()
    np.testing.assert_allclose(fit.model.matrix, np.diag([1.02, 0.985, 1.01]), atol=1e-12)
    assert fit.temperature == pytest.approx(35.0)
    assert fit.sd[:3].max() <= 0.005
    assert prompts[-1].detected == Pose(face)
    tilted = run("accel-one-axis", bench, ardupilot(**scales), fixture_sd=1.0)[0].results[0]
    assert tilted.sd[:3].max() == pytest.approx(9.80665 * np.radians(1.0), rel=0.01)


def test_one_axis_on_a_board_that_is_turned_by_an_odd_angle():
    truth = Truth((0.31, -0.22, 0.17), YAW_45.T, noise=0.02)
    bench = Bench(accels=(truth,)).hold(10.0, attitude(0.0, -90.0))  # nose down: no axis of the sensor is vertical
    outcome, prompts = run("accel-one-axis", bench, ardupilot(AHRS_ORIENTATION=1), fixture_sd=0.0)
    (fit,) = outcome.results
    assert prompts[-1].detected == Pose.NOSE_DOWN
    assert (np.abs(fit.model.offset - truth.offset) < 4.5 * fit.sd[:3]).all()


def test_one_axis_that_is_not_vertical_or_never_at_rest_ends_with_the_cause():
    outcome, prompts = run("accel-one-axis", Bench().hold(60.0, attitude(30.0, 0.0)), patience=40.0)
    assert isinstance(outcome, GaveUp)
    assert re.search(r"vertical\D* (2\d|3\d) deg", outcome.cause)
    assert any("No axis" in p.text for p in prompts)
    outcome, _ = run("accel-one-axis", Bench().hold(60.0, tremor=2.0), patience=40.0)
    assert isinstance(outcome, GaveUp)
    assert "vertical" not in outcome.cause
    assert re.search(r" 4\d s", outcome.cause)


# -- six faces ---------------------------------------------------------------------------------------------------------


def test_six_faces_give_the_full_matrix():
    truth = Truth((0.31, -0.22, 0.17), CROSS, noise=0.02)
    outcome, prompts = run(
        "accel-six-face", on_faces(Bench(accels=(truth, truth), gyros=Bench().gyros * 2)), fixture_sd=0.0
    )
    assert isinstance(outcome, Done), outcome
    assert [fit.instance for fit in outcome.results] == [0, 1]
    for fit in outcome.results:
        assert (known_to(fit, truth) < 4.5).all()
        assert fit.sd[:3].max() <= 0.01
        assert fit.temperature == pytest.approx(35.0)
    assert {p.step for p in prompts} == {"place"}
    assert sorted({len(p.remaining) for p in prompts}, reverse=True) == [6, 5, 4, 3, 2, 1]


def test_six_faces_of_a_board_that_is_turned_refer_to_the_raw_sensor():
    truth = Truth((0.31, -0.22, 0.17), CROSS @ YAW_45.T, noise=0.02)
    outcome, _ = run("accel-six-face", on_faces(Bench(accels=(truth,))), ardupilot(AHRS_ORIENTATION=1), fixture_sd=0.0)
    assert (known_to(outcome.results[0], truth, np.linalg.inv(CROSS)) < 4.5).all()


def test_a_face_that_is_lifted_too_early_is_asked_for_again():
    bench = Bench().hold(2.2).hold(0.3, attitude(-60.0, 10.0), move=0.3)
    outcome, prompts = run("accel-six-face", on_faces(bench), fixture_sd=0.0)
    assert isinstance(outcome, Done)
    assert any("moved too early" in p.text for p in prompts)


def test_faces_that_contradict_each_other_are_all_taken_again_and_then_given_up():
    bench = on_faces(on_faces(Bench(), tilt=3.0), tilt=-3.0)
    outcome, prompts = run("accel-six-face", bench, fixture_sd=0.05)
    assert "contradict" in outcome.cause
    assert any("take all six again" in p.text for p in prompts)
    good = on_faces(on_faces(Bench(), tilt=3.0))
    assert isinstance(run("accel-six-face", good, fixture_sd=0.05)[0], Done)


def test_a_fixture_that_allows_no_more_is_said():
    outcome, _ = run("accel-six-face", on_faces(Bench()), fixture_sd=1.0)
    assert "a tilt of 1 deg of the fixture allows no more" in outcome.cause
    assert "accel" in outcome.remedy


def test_missing_faces_are_named():
    outcome, _ = run("accel-six-face", on_faces(Bench(), faces=["level", "back"]))
    assert "2 faces were taken and 4 are missing" in outcome.cause
    assert "nose down" in outcome.remedy


# -- six rings ---------------------------------------------------------------------------------------------------------


def test_six_rings_give_the_compass_and_its_mounting():
    askew = Rotation.from_euler("Z", 2.0, degrees=True).as_matrix()
    truth = replace(MAG, sensitivity=MAG.sensitivity @ askew.T)
    outcome, prompts = run("mag-rings", turned(Bench(seed=4, mags=(truth,))), fixture_sd=0.0)
    (fit,) = outcome.results
    assert (known_to(fit, truth) < 4.5).all()
    assert fit.quality["orientation"]["verdict"] == "as_stated"
    assert fit.quality["orientation"]["askew_deg"] == pytest.approx(2.0, abs=0.3)
    assert {p.step for p in prompts} == {"place", "turn"}
    turns = [p for p in prompts if p.step == "turn"]
    assert {p.axis for p in turns} == {tuple(map(float, d)) for d in DOWN.values()}
    assert len([p for p in turns if p.stable]) == 6


@pytest.mark.long
def test_rings_of_a_compass_that_is_mounted_otherwise_find_its_rotation():
    quarter = Rotation.from_euler("Z", 90.0, degrees=True).as_matrix()
    truth = replace(MAG, sensitivity=MAG.sensitivity @ quarter.T)
    (fit,) = run("mag-rings", turned(Bench(mags=(truth,))), fixture_sd=0.0)[0].results
    assert (fit.quality["orientation"]["verdict"], fit.quality["orientation"]["name"]) == ("rotated", "yaw_90")
    odd = replace(MAG, sensitivity=MAG.sensitivity @ YAW_45.T)
    outcome, _ = run("mag-rings", turned(Bench(mags=(odd,))), fixture_sd=0.0)
    found = outcome.results[0].quality["orientation"]
    assert (found["verdict"], found["yaw"]) == ("by_angles", pytest.approx(45.0, abs=0.5))
    assert 0.0 < max(found["sd_deg"]) < 0.5
    (tilted,) = run("mag-rings", turned(Bench(mags=(odd,))), fixture_sd=0.1, uncertainty=1.0)[0].results
    assert min(tilted.quality["orientation"]["sd_deg"]) > max(found["sd_deg"])  # a fixture that may be tilted


@pytest.mark.parametrize("dip", [60.0, -60.0])
def test_rings_of_a_mirrored_compass_are_refused_by_name(dip):
    field = field_of(50.0, np.radians(dip))
    truth = replace(MAG, sensitivity=MAG.sensitivity @ np.diag([1.0, -1.0, 1.0]))
    context = replace(CONTEXT, earth_field=field)
    outcome, _ = run(
        "mag-rings", turned(Bench(mags=(truth,), field_ned=field.north_east_down)), context, fixture_sd=0.0
    )
    assert "its y axis reads with the wrong sign, which no mounting does" in outcome.cause
    good, _ = run("mag-rings", turned(Bench(mags=(MAG,), field_ned=field.north_east_down)), context, fixture_sd=0.0)
    assert good.results[0].quality["orientation"]["verdict"] == "as_stated"


def test_a_ring_that_is_too_fast_or_tilted_is_begun_anew():
    bench = Bench().hold(3.0).turn(2.0, [0, 0, 200.0]).hold(2.0).turn(4.0, [0, 0, 45.0]).hold(2.0, attitude(40.0, 0.0))
    outcome, prompts = run("mag-rings", turned(bench), fixture_sd=0.0)
    assert isinstance(outcome, Done), outcome
    assert any("too fast" in p.text for p in prompts)
    assert any("tilted before the turn was complete" in p.text for p in prompts)


def test_rings_that_allow_no_more_say_why():
    outcome, _ = run("mag-rings", turned(Bench()), fixture_sd=1.0)
    assert "a tilt of 1 deg of the faces allows no more" in outcome.cause
    flat = np.array([48.0, 0.0, 0.3])
    equator = replace(CONTEXT, earth_field=EarthField(flat))
    outcome, _ = run("mag-rings", turned(Bench(field_ned=flat)), equator, fixture_sd=0.0)
    assert "magnetic equator" in outcome.cause
    outcome, _ = run("mag-rings", turned(Bench(), faces=["level", "left"]))
    assert "2 rings were taken and 4 are missing" in outcome.cause


def test_steps_do_not_depend_on_the_chunks(chunks):
    recording = turned(Bench(seed=5)).record()
    whole, cut = (create("mag-rings", {"fixture_sd": 0.0}, CONTEXT) for _ in range(2))
    steps = [*whole.feed(recording), *whole.end()]
    pieces = [s for part in chunks(recording, np.arange(100.0, 190.0, 0.37)) for s in cut.feed(part)]
    assert [repr(s) for s in steps if not isinstance(s, Done)] == [repr(s) for s in pieces if not isinstance(s, Done)]
    np.testing.assert_array_equal(whole.outcome.results[0].values, cut.outcome.results[0].values)
    assert whole.present(Sensor.MAG) == (0,)
