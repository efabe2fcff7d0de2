from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.plan import (
    AfterWrite,
    Change,
    Fingerprint,
    Loss,
    Movement,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Verification,
    WritePlan,
)
from mavcal.calib.fit import FitBuilder, FitResult, FitStatus
from mavcal.calib.procedures.protocol import Done, GaveUp, Number, Pose, Progress, Prompt, PromptStep
from mavcal.calib.recording import Sensor
from mavcal.calib.report import from_json, to_json
from mavcal.calib.triad import ThermalPolynomial, TriadModel

KEYS_OF_DESIGN = {
    *("method", "status", "message", "n_samples", "n_used", "relative", "model", "sd", "native"),
    *("residual_rms", "unit", "condition_number", "undetermined", "warnings", "quality"),
}


def thermal_fit(rng: np.random.Generator) -> FitResult:
    root = rng.normal(size=(18, 18))
    covariance = root @ root.T
    covariance[2, :] = covariance[:, 2] = 0.0
    covariance[12, :] = covariance[:, 12] = 0.0
    return FitResult(
        method="thermal-linear",
        sensor=Sensor.GYRO,
        instance=1,
        status=FitStatus.PARTIAL,
        message="z never moved",
        model=TriadModel(
            rng.normal(size=3), rng.normal(size=(3, 3)), ThermalPolynomial(35.0, -3.25, 61.0, rng.normal(size=(3, 2)))
        ),
        covariance=covariance,
        unit="rad/s",
        n_samples=10,
        n_used=9,
        residual_rms=0.1,
        condition_number=3.0,
        undetermined=("offset_z",),
        warnings=("a warning",),
        temperature=35.0,
        quality={"chi2": np.float64(0.1), "mask": np.array([True, False]), "none": None},
        native={"slopes": [1.0, 2.0, None]},
    )


def plan() -> WritePlan:
    return WritePlan(
        fingerprint=Fingerprint("ardupilot", "00ff", "4.7.0", (("INS_ACC_ID", 2753028),)),
        snapshot_sha256="ab",
        changes=(
            Change(
                "INS_ACCOFFS_X",
                0.1,
                float(np.float32(0.3)),
                ParameterKind.REAL32,
                "offset",
                0.001,
                "m/s2",
                Sensor.ACCEL,
            ),
            Change("COMPASS_LEARN", None, 0, ParameterKind.INT8, "autocal off", session=True),
        ),
        losses=(Loss(Sensor.ACCEL, 0, "cross terms", 0.02, "m/s2", "not storable"),),
        after=(AfterWrite(241, (0.0, 0.0, 0.0, 0.0, 76.0, 0.0, 0.0), "ids"),),
        warnings=("w",),
    )


def through_text(data: object) -> dict[str, object]:
    return dict(json.loads(json.dumps(data, allow_nan=False)))


def test_the_json_of_a_fit_has_the_keys_of_the_design():
    data = to_json(thermal_fit(np.random.default_rng(1)))
    assert data.keys() >= KEYS_OF_DESIGN
    assert data.keys() - KEYS_OF_DESIGN == {"sensor", "instance", "temperature", "covariance", "movements"}
    assert data["model"].keys() == data["sd"].keys() == {"offset", "matrix", "polynomial"}
    assert data["model"]["polynomial"].keys() == {"t_ref", "t_min", "t_max", "coefficients"}
    assert np.shape(data["sd"]["polynomial"]["coefficients"]) == np.shape(data["model"]["polynomial"]["coefficients"])


def test_the_sd_is_null_where_undetermined_and_zero_where_fixed():
    sd = to_json(thermal_fit(np.random.default_rng(1)))["sd"]
    assert sd["offset"][2] is None
    assert sd["offset"][0] > 0
    assert sd["polynomial"]["coefficients"][0][0] == 0.0


def test_a_refused_fit_states_no_uncertainty_at_all():
    data = through_text(to_json(FitBuilder("m", Sensor.MAG, 0, "uT", 3).refused("no")))
    assert data["sd"] == {"offset": [None] * 3, "matrix": [[None] * 3] * 3, "polynomial": None}
    assert to_json(from_json(data, FitResult)) == data


@given(st.integers(0, 2**32 - 1))
def test_a_fit_survives_text_bit_by_bit(seed):
    fit = thermal_fit(np.random.default_rng(seed))
    back = from_json(through_text(to_json(fit)), FitResult)
    assert (back.covariance == fit.covariance).all()
    assert (back.values == fit.values).all()
    assert to_json(back) == to_json(fit)
    for name in ("method", "sensor", "instance", "status", "undetermined", "warnings", "temperature", "n_used"):
        assert getattr(back, name) == getattr(fit, name)


def test_a_fit_without_its_model_is_an_input_error():
    data = to_json(thermal_fit(np.random.default_rng(1)))
    del data["model"]
    with pytest.raises(InvalidInputError, match="not the JSON of a fit"):
        from_json(data, FitResult)


def test_a_plan_survives_text_with_its_digest_and_its_integers():
    original = plan()
    back = from_json(through_text(to_json(original)), WritePlan)
    assert back == original
    assert back.sha256 == original.sha256
    assert isinstance(back.changes[1].new, int)


def test_an_altered_plan_is_not_read():
    data = to_json(plan())
    data["changes"][0]["new"] = 9.0
    with pytest.raises(InvalidInputError, match="plan again"):
        from_json(data, WritePlan)


def test_a_verification_survives_text():
    movement = Movement("turn it", faces=("left",), turn=True, temperature=20.0)
    sensors = (
        SensorCheck(
            SensorCheckId.GYRO_ZERO, Sensor.GYRO, 1, 0.01, 0.002, "rad/s", 1e-4, SensorVerdict.WRONG, "gyro 2 turns"
        ),
        SensorCheck(
            SensorCheckId.ACCEL_GRAVITY,
            Sensor.ACCEL,
            0,
            None,
            None,
            "m/s2",
            None,
            SensorVerdict.NOT_OBSERVABLE,
            "moved",
        ),
    )
    verdict = ParameterVerdict("A", ProofVerdict.CONTRADICTED, 0.1, 0.01, "m/s2", "t")
    check = Verification((verdict,), movement, sensors)
    data = through_text(to_json(check))
    assert data["contradicted"] == ["A"]
    assert data["refuted"] == ["gyro_zero of gyro 2"]
    assert data["sensors"][0]["value"] == 0.01
    assert check.must_go == "accepted but without effect on the stream: A; gyro 2 turns"
    assert data["proved"] is False
    assert from_json(data, Verification) == check


@pytest.mark.parametrize(
    "step",
    [
        Prompt(PromptStep.POSE, "Hold it", pose=Pose.LEFT, remaining=(Pose.LEFT, Pose.BACK), direction=(0.0, 1.0, 0.0)),
        Prompt(PromptStep.HOLD_STILL, "Ready?", answers=("finish",), stable=True, detected=Pose.LEVEL),
        Prompt(PromptStep.TURN, "Turn it", pose=Pose.LEVEL, axis=(0.0, 0.0, -1.0), turns=10.0),
        Prompt(PromptStep.STATE, "How fast?", number=Number("rate", "deg/s", 1.0, 1000.0)),
        Progress(1.0, 2.0, "s", "half", eta=None, detail={"mask": [1, 2]}),
        GaveUp("nothing moved", "move it"),
    ],
)
def test_steps_survive_text(step):
    data = through_text(to_json(step))
    assert data["type"] in {"prompt", "progress", "gave_up"}
    assert from_json(data, type(step)) == step


def test_a_prompt_of_before_numbers_were_asked_for_is_still_read():
    data = to_json(Prompt(PromptStep.HOLD_STILL, "Ready?", answers=("finish",)))
    for name in ("axis", "turns", "number"):
        del data[name]
    assert from_json(data, Prompt) == Prompt(PromptStep.HOLD_STILL, "Ready?", answers=("finish",))


def test_done_carries_its_fits():
    fit = thermal_fit(np.random.default_rng(5))
    data = through_text(to_json(Done((fit,), "accurate enough")))
    back = from_json(data, Done)
    assert isinstance(back, Done)
    assert to_json(back.results[0]) == to_json(fit)


def test_an_unknown_step_is_an_input_error():
    with pytest.raises(InvalidInputError, match="'shout'"):
        from_json({"type": "shout"}, Prompt)


def test_numbers_that_are_not_finite_become_null():
    assert to_json({"a": np.array([np.nan, np.inf, 1.0]), "b": np.int64(3)}) == {"a": [None, None, 1.0], "b": 3}


def test_a_type_without_a_form_is_refused():
    with pytest.raises(InvalidInputError, match="complex"):
        to_json(1j)


def test_dataclass_fields_are_all_written():
    change = plan().changes[0]
    assert to_json(change).keys() == {f.name for f in dataclasses.fields(Change)}
