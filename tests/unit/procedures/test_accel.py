from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mavcal.calib.procedures.accel import SPEC, AccelProcedure
from mavcal.calib.procedures.protocol import Done, GaveUp, Pose, Progress, Prompt
from mavcal.calib.procedures.spec import ProcedureContext
from mavcal.calib.recording import Identity, Sensor

WITHOUT_SHRINKING = (Phase.explicit, Phase.generate)  # a run takes too long for it
CONTEXT = ProcedureContext(identity=Identity(autopilot="other"), parameters={"X": 1.0})
FACES = [(0, 0), (-90, 0), (90, 0), (0, -90), (0, 90), (180, 0)]
OBLIQUE = [(35, 20), (-50, 40), (-140, 30), (45, -40)]
CROSS = np.array([[1.02, 0.004, -0.003], [0.004, 0.985, 0.002], [-0.003, 0.002, 1.01]])


def pose(roll, pitch, yaw=0.0):
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)


def held(bench, poses, seconds=4.0, tremor=0.25, seed=3, tilt=5.0, **fields):
    made = bench(seed=seed, **fields)
    rng = np.random.default_rng(seed)
    for roll, pitch in poses:
        askew = Rotation.from_rotvec(np.radians(tilt) / np.sqrt(3) * rng.standard_normal(3))
        made.hold(seconds, pose(roll, pitch) * askew, tremor=tremor)
    return made


def run(recording, chunks=None, context=CONTEXT, **options):
    procedure = AccelProcedure(SPEC.validated(options), context)
    steps = [s for part in (chunks or [recording]) for s in procedure.feed(part)]
    return procedure, steps + list(procedure.end())


def deviations(fit, truth):
    """(estimate - truth) / sd over offsets and the six numbers of the symmetric correction matrix."""
    correction = np.linalg.inv(truth.sensitivity)
    values, vectors = np.linalg.eigh(correction.T @ correction)
    symmetric = (vectors * np.sqrt(values)) @ vectors.T
    error = fit.values - np.concatenate([truth.offset, symmetric.ravel()])
    known = fit.sd > 0
    return np.abs(error[known] / fit.sd[known])


def test_six_faces_and_four_oblique_poses_by_hand_give_every_accelerometer(bench):
    one = replace(bench().accels[0], sensitivity=CROSS)
    two = replace(one, offset=(-0.2, 0.1, 0.3), quantum=9.80665e-3)
    procedure, _ = run(held(bench, FACES + OBLIQUE, accels=(one, two), gyros=bench().gyros * 2).record())
    assert isinstance(procedure.outcome, Done), procedure.outcome
    for fit, truth in zip(procedure.outcome.results, (one, two), strict=True):
        assert (deviations(fit, truth) < 4.5).all()
        assert fit.sd[:3].max() <= 0.005
        assert fit.quality["dof"] >= 3
        assert fit.temperature == pytest.approx(35.0)


def test_the_order_of_the_poses_is_free_and_the_prompts_count_down(bench):
    order = [OBLIQUE[3], OBLIQUE[1], FACES[5], FACES[1], OBLIQUE[0], FACES[0], FACES[4], FACES[2], OBLIQUE[2], FACES[3]]
    procedure, steps = run(held(bench, order).record())
    assert isinstance(procedure.outcome, Done)
    prompts = [s for s in steps if isinstance(s, Prompt)]
    left = [len(p.remaining) for p in prompts]
    assert left[0] == 10
    assert sorted(set(left), reverse=True) == list(range(10, 0, -1))
    assert {p.detected for p in prompts if p.stable} >= {Pose.BACK, Pose.OBLIQUE, Pose.NOSE_UP}
    assert all(p.step == "pose" and not p.answers for p in prompts)


def test_a_pose_that_is_disturbed_is_asked_for_again(bench):
    made = held(bench, FACES[:1])
    made.hold(2.2, pose(*FACES[1]))
    made.hold(0.6, pose(-60, 30), move=0.2)
    for p in FACES[1:] + OBLIQUE:
        made.hold(4.0, pose(*p), tremor=0.25)
    procedure, steps = run(made.record())
    assert isinstance(procedure.outcome, Done)
    assert any("disturbed" in s.text for s in steps if isinstance(s, Prompt))


def test_a_pose_that_contradicts_the_others_is_named_and_taken_again(bench):
    poses = [*FACES, *OBLIQUE, (20, -60), (60, 10), FACES[4]]
    made = held(bench, poses)
    recording = made.record()
    accel = recording.channel(Sensor.ACCEL)
    fifth = slice(*np.searchsorted(accel.t, (100 + 4 * 5.5, 100 + 4 * 5.5 + 4.2)))
    accel.values[fifth] *= 1.01  # pushed while nose up
    procedure, steps = run(recording)
    assert isinstance(procedure.outcome, Done), procedure.outcome
    assert any("disagrees" in s.text and "nose up" in s.text for s in steps if isinstance(s, Prompt))
    assert (deviations(procedure.outcome.results[0], made.accels[0]) < 4.5).all()


@pytest.mark.long
def test_poses_that_never_agree_end_with_the_cause(bench):
    made = held(bench, [*FACES, *OBLIQUE, (20, -60), (60, 10), (-30, -40), (130, 40), (-130, -20), (110, -5), (-45, 0)])
    recording = made.record()
    accel = recording.channel(Sensor.ACCEL)
    push = np.random.default_rng(5).standard_normal(60)[((accel.t - 100) / 5.5).astype(int)]
    accel.values[:] *= (1.0 + 0.02 * push)[:, None]
    procedure, _ = run(recording)
    assert isinstance(procedure.outcome, GaveUp)
    assert "disagree" in procedure.outcome.cause
    assert procedure.outcome.remedy


def test_missing_poses_are_named_at_the_end_of_a_recording(bench):
    procedure, _ = run(held(bench, FACES[:4]).record())
    assert isinstance(procedure.outcome, GaveUp)
    assert "4 poses" in procedure.outcome.cause
    assert " 6 are" in procedure.outcome.cause
    assert "its back" in procedure.outcome.remedy


def test_lying_on_the_table_for_ever_ends_the_job(bench):
    procedure, _ = run(bench().hold(90.0).record(), patience=60.0)
    assert isinstance(procedure.outcome, GaveUp)
    assert "no new pose" in procedure.outcome.cause


def test_the_board_rotation_of_ardupilot_turns_what_is_called_level(bench):
    parameters = {f"INS_ACCOFFS_{a}": 0.0 for a in "XYZ"} | {f"INS_ACCSCAL_{a}": 1.0 for a in "XYZ"}
    parameters |= {"AHRS_ORIENTATION": 8, "INS_TCAL1_ENABLE": 0}  # roll 180
    context = ProcedureContext(identity=Identity(autopilot="ardupilot"), parameters=parameters)
    _, steps = run(held(bench, FACES[:1]).record(), context=context)
    assert {s.detected for s in steps if isinstance(s, Prompt) and s.stable} == {Pose.BACK}


def test_a_noisy_accelerometer_is_held_longer(bench):
    noisy = replace(bench().accels[0], noise=0.07)
    quick = run(held(bench, FACES[:1], 12.0).record())[1]
    slow = run(held(bench, FACES[:1], 12.0, accels=(noisy,)).record())[1]

    def first_pose_at(steps):
        return next(i for i, s in enumerate(s for s in steps if isinstance(s, Progress)) if s.current == 1)

    assert first_pose_at(slow) > first_pose_at(quick) + 2


@pytest.mark.long
@settings(
    deadline=None, max_examples=5, phases=WITHOUT_SHRINKING, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(cuts=st.lists(st.floats(100.0, 150.0), max_size=60))
def test_steps_and_digits_do_not_depend_on_the_chunks(bench, chunks, cuts):
    recording = held(bench, FACES + OBLIQUE).record()
    whole, steps = run(recording)
    cut, pieces = run(recording, chunks(recording, cuts))
    assert [repr(s) for s in steps if not isinstance(s, Done)] == [repr(s) for s in pieces if not isinstance(s, Done)]
    np.testing.assert_array_equal(whole.outcome.results[0].values, cut.outcome.results[0].values)
