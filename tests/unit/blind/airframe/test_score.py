from __future__ import annotations

import json
from typing import Any

import pytest

from mavcal.calib.blind.airframe.answers import AirAnswer, told_of
from mavcal.calib.blind.airframe.cases import AirTier, make_air_label
from mavcal.calib.blind.airframe.score import air_score
from mavcal.calib.blind.answers import CaseAnswer

Json = dict[str, Any]


def effect(name: str, domain: str, params: list[Json], instances: tuple[int, ...] = (), **more: Any) -> Json:
    evidence = {"two_delta_loglik": more.get("gain", 100.0), "probability": more.get("probability", 0.95)}
    rivals = [{"id": rival} for rival in more.get("rivals", ())]
    return {
        "id": name,
        "domain": domain,
        "params": params,
        "instances": list(instances),
        "evidence": evidence,
        "confusable_with": rivals,
    }


def said(name: str, value: float, *, ratio: bool = False, width: float = 0.01) -> Json:
    interval = [value - width, value + width]
    one: Json = {"name": name, "value": value, "ci95": interval, "ratio": None, "ratio_ci95": None}
    if ratio:
        one |= {"ratio": 1.0 + value, "ratio_ci95": [1.0 + x for x in interval]}
    return one


RELATIVE = {"thrust_scale", "rotor_drag", "body_drag", "inertia", "yaw_coefficient", "angular_damping", "motor_weak"}


def truthful(label: Json) -> Json:
    """A report that says exactly what was put in."""
    effects = [
        effect(
            entry["id"],
            entry["domain"],
            [said(k, v, ratio=entry["id"] in RELATIVE) for k, v in entry["params"].items()],
            tuple(entry["instances"]),
        )
        for entry in label["effects"]
    ]
    rollout = [{"h_s": 1.0, "quantity": "velocity", "part": "blocks", "closed": 0.97}]
    return {
        "effects": effects,
        "unknown": {"flag": bool(label["unknown"])},
        "verdict": "explained" if effects else "no_gap",
        "airframe": {"rollout": rollout, "probabilities": {e["id"]: 0.95 for e in label["effects"]}},
    }


def answer(tier: AirTier, seed: int, report: Json | None = None) -> CaseAnswer:
    label = make_air_label(tier, seed)
    return CaseAnswer(label, truthful(label) if report is None else report, None, 3.0)


def of(tier: AirTier, name: str) -> int:
    """A seed whose only effect is of that name."""
    return next(s for s in range(2000) if [e["id"] for e in make_air_label(tier, s)["effects"]] == [name])


def figures(answers: list[CaseAnswer]) -> dict[str, Json]:
    found = air_score(answers)
    json.dumps(found)
    return {figure["name"]: figure for figure in found["figures"]}


def test_who_says_the_truth_reaches_everything():
    tiers = (AirTier.NULL, AirTier.SINGLE, AirTier.MIXED, AirTier.FOREIGN, AirTier.UNKNOWN)
    found = figures([answer(tier, seed) for tier in tiers for seed in range(20)])
    assert found["null: a false name, or unknown"]["value"] == 0.0
    assert found["single: top-1, detected"]["value"] == 1.0
    assert found["single: truth in the set, detected"]["value"] == 1.0
    assert found["single: mean size of the set"]["value"] == 1.0
    assert found["mixed: F1"]["value"] == 1.0
    assert found["unknown: flagged"]["value"] == 1.0
    assert found["a sensor named for an airframe or the reverse"]["value"] == 0.0
    assert found["95 % intervals hold"]["value"] == 1.0
    assert found["error of thrust ratio: median"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert found["1 s velocity error closed, held out: median"]["value"] == pytest.approx(0.97)
    assert found["probabilities: ECE"]["value"] == pytest.approx(0.05)


def test_the_days_air_is_no_false_name_and_an_airframe_is():
    seed = next(s for s in range(100) if "wind" in make_air_label(AirTier.NULL, s)["differs"])
    wind = {"effects": [effect("wind", "environment", [said("north", 1.0)])], "unknown": {"flag": False}}
    drag = {"effects": [effect("rotor_drag", "airframe", [said("c1", 0.2)])], "unknown": {"flag": False}}
    assert figures([answer(AirTier.NULL, seed, wind)])["null: a false name, or unknown"]["value"] == 0.0
    assert figures([answer(AirTier.NULL, seed, drag)])["null: a false name, or unknown"]["value"] == 1.0
    slip = {"effects": [effect("ekf_reset", "environment", [])], "unknown": {"flag": False}}
    assert figures([answer(AirTier.NULL, seed, slip)])["null: a false name of the day's air"]["value"] == 1.0


def test_the_strongest_counts_and_rivals_are_in_the_set():
    seed = of(AirTier.SINGLE, "thrust_expo")
    one = effect("battery_sag", "airframe", [], gain=90.0, rivals=("thrust_expo",))
    found = figures([answer(AirTier.SINGLE, seed, {"effects": [one], "unknown": {"flag": False}})])
    assert found["single: top-1, detected"]["value"] == 0.0
    assert found["single: truth in the set, detected"]["value"] == 1.0
    assert found["single: mean size of the set"]["value"] == 2.0


def test_a_sensor_blamed_for_an_airframe_is_misplaced():
    label = make_air_label(AirTier.SINGLE, of(AirTier.SINGLE, "inertia"))
    blamed = {"effects": [effect("gyro_scale", "sensor", [])], "unknown": {"flag": False}}
    assert AirAnswer(label, blamed, None, 1.0).misplaced
    assert not AirAnswer(label, truthful(label), None, 1.0).misplaced


def test_a_wrong_motor_has_no_size():
    label = make_air_label(AirTier.SINGLE, of(AirTier.SINGLE, "motor_weak"))
    report = truthful(label)
    assert [t.name for t in told_of(AirAnswer(label, report, None, 1.0))] == ["s", "motor"]
    report["effects"][0]["instances"] = [label["effects"][0]["instances"][0] % 4 + 1]
    assert told_of(AirAnswer(label, report, None, 1.0)) == []


def test_an_interval_that_misses_is_counted():
    label = make_air_label(AirTier.SINGLE, of(AirTier.SINGLE, "thrust_scale"))
    true = label["effects"][0]["params"]["s"]
    off = effect("thrust_scale", "airframe", [said("s", true + 0.05, ratio=True)])
    (told,) = told_of(AirAnswer(label, {"effects": [off]}, None, 1.0))
    assert told.held is False
    assert told.size_error(relative=True) == pytest.approx(0.05 / (1.0 + true))
    off["params"][0]["ratio_ci95"] = [None, 2.0]
    assert told_of(AirAnswer(label, {"effects": [off]}, None, 1.0))[0].held is None


def test_what_cannot_be_told_is_excused_and_what_is_left_out_may_have_an_honest_name():
    poor = answer(AirTier.LOGGING, 3, {"effects": [], "verdict": "not_testable"})
    found = figures([poor])
    assert found["poor log: said to be not testable"]["value"] == 1.0
    assert found["poor log: a false name, or unknown"]["value"] == 0.0
    seed = of(AirTier.LEFT_OUT, "motor_lag")
    late = {"effects": [effect("actuator_delay", "airframe", [])], "unknown": {"flag": False}}
    assert figures([answer(AirTier.LEFT_OUT, seed, late)])["left out: unknown or honest, detected"]["value"] == 1.0
    false = {"effects": [effect("cg_offset", "airframe", [])], "unknown": {"flag": False}}
    assert figures([answer(AirTier.LEFT_OUT, seed, false)])["left out: unknown or honest, detected"]["value"] == 0.0


def test_an_error_is_a_miss_and_scored():
    failed = CaseAnswer(make_air_label(AirTier.NULL, 1), {}, "ValueError: x", 1.0)
    found = figures([failed])
    assert found["failed with an error"]["verdict"] == "missed"
    assert air_score([failed])["errors"] == [("ValueError: x", 1)]


def test_probabilities_fall_into_five_bins():
    """Of everything that was tested, not only of what was reported."""
    doubtful = {"effects": [], "unknown": {"flag": False}, "verdict": "no_gap"}
    doubtful["airframe"] = {"probabilities": {"inertia": 0.5, "thrust_scale": 0.001}}
    rows = air_score([answer(AirTier.NULL, 1, doubtful)])["by_probability"]
    assert [row["right"]["n"] for row in rows] == [0, 0, 1, 0, 0]
    assert rows[2]["right"]["value"] == 0.0
    rows = air_score([answer(AirTier.SINGLE, seed) for seed in range(20)])["by_probability"]
    assert [row["right"]["n"] for row in rows] == [0, 0, 0, 0, 20]
    assert rows[-1]["mean"] == pytest.approx(0.95)
