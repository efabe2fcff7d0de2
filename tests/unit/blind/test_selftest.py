from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from mavcal.calib.blind.airframe.cases import AirTier, make_air_label
from mavcal.calib.blind.airframe.seal import air_generator_sha256
from mavcal.calib.blind.cases import FIRST_SEALED, Tier, make_label
from mavcal.calib.blind.real import KINDS, fast_sd, injected
from mavcal.calib.blind.seal import generator_sha256, labels_sha256
from mavcal.calib.recording import Channel, Recording, Sensor, Stage
from mavcal.service.commands.gap_campaign import answers, diagnoser
from mavcal.service.commands.gap_selftest import command


def recording() -> Recording:
    rng = np.random.default_rng(2)
    t = np.arange(4000) / 100.0
    motion = np.sin(0.7 * t)[:, None] * np.array([3.0, -2.0, 1.0])

    def channel(sensor: Sensor, sd: float, unit: str) -> Channel:
        return Channel(sensor, 0, t, motion + sd * rng.standard_normal((4000, 3)), unit, Stage.RAW, "test")

    return Recording(
        (channel(Sensor.ACCEL, 0.02, "m/s2"), channel(Sensor.GYRO, 0.01, "rad/s"), channel(Sensor.MAG, 0.4, "uT"))
    )


@pytest.mark.parametrize("kind", KINDS)
def test_an_effect_goes_into_one_channel_of_a_real_recording(kind):
    before = recording()
    after, label = injected(before, kind, 5)
    changed = [
        c.sensor.value
        for c, d in zip(before.channels, after.channels, strict=True)
        if not np.array_equal(c.values, d.values)
    ]
    assert changed == [kind.partition("_")[0]]
    assert 1e3 <= label["lambda_of_fast_noise"] <= 1e5
    assert np.array_equal(injected(before, kind, 5)[0].channels[0].values, after.channels[0].values)


def test_motion_is_no_noise():
    assert fast_sd(recording().channel(Sensor.GYRO)) == pytest.approx(0.01, rel=0.05)


@pytest.mark.long
def test_the_seal_is_that_of_the_labels_of_these_seeds(tmp_path):
    out = tmp_path / "seal.json"
    done = CliRunner().invoke(
        command, ["--seal", str(out), "--tier", "T0", "--count", "2", "--seed", str(FIRST_SEALED)]
    )
    assert done.exit_code == 0, done.output
    seal = json.loads(out.read_text())
    assert seal["cases"] == {"T0": 2}
    assert seal["labels_sha256"] == labels_sha256([make_label(Tier.NULL, FIRST_SEALED + k) for k in (0, 1)])


def test_the_airframes_seal_is_that_of_its_own_generator(tmp_path):
    out = tmp_path / "seal.json"
    arguments = ["--tier", "A0", "--tier", "A6", "--count", "2", "--seed", str(FIRST_SEALED)]
    done = CliRunner().invoke(command, ["--seal", str(out), *arguments])
    assert done.exit_code == 0, done.output
    seal = json.loads(out.read_text())
    assert seal["cases"] == {"A0": 2, "A6": 2}
    assert seal["generator_sha256"] == air_generator_sha256() != generator_sha256()
    labels = [make_air_label(tier, FIRST_SEALED + k) for tier in (AirTier.NULL, AirTier.UNKNOWN) for k in (0, 1)]
    assert seal["labels_sha256"] == labels_sha256(labels)


def test_tiers_of_both_kinds_are_not_run_together():
    done = CliRunner().invoke(command, ["--tier", "T0", "--tier", "A0"])
    assert done.exit_code == 2
    assert "one kind at a time" in done.output


def test_the_airframes_answers_are_scored_again(tmp_path):
    row = {"label": make_air_label(AirTier.NULL, 3), "report": {"verdict": "no_gap", "effects": []}, "seconds": 1.0}
    file = tmp_path / "answers.jsonl"
    file.write_text(json.dumps(row) + "\n")
    arguments = ["--score-only", "--answers", str(file)]
    done = CliRunner().invoke(command, [*arguments, "--json"], standalone_mode=False)
    first = json.loads(done.stdout)["figures"][0]
    assert (first["name"], first["value"]) == ("null: a false name, or unknown", 0.0)
    assert "by probability" in CliRunner().invoke(command, arguments).output


@pytest.mark.long
def test_kept_answers_are_scored_again(tmp_path):
    label = make_label(Tier.NULL, 3)
    row = {"label": label, "report": {"verdict": "no_gap", "effects": []}, "seconds": 1.0}
    file = tmp_path / "answers.jsonl"
    file.write_text(
        json.dumps(row) + "\n" + json.dumps({"label": label, "error": "ValueError: x", "seconds": 1.0}) + "\n"
    )
    assert [a.failed for a in answers(file.read_text().splitlines())] == [None, "ValueError: x"]
    done = CliRunner().invoke(command, ["--score-only", "--answers", str(file), "--json"], standalone_mode=False)
    assert done.return_value == 1  # one failed
    document = json.loads(done.stdout)
    assert document["schema"] == "gap-selftest/1"
    assert next(f for f in document["figures"] if f["name"].startswith("null:"))["value"] == 0.0
    file.write_text(json.dumps(row) + "\n")
    done = CliRunner().invoke(command, ["--score-only", "--answers", str(file), "--json"], standalone_mode=False)
    assert done.return_value == 1  # none failed, and one null is no proof that at most one of a hundred is named


@pytest.mark.long
@pytest.mark.parametrize(
    ("timeout_s", "error"), [(60.0, "no such file"), (0.01, "longer than 0.01 s")], ids=["refused", "too slow"]
)
async def test_what_goes_wrong_is_an_answer_and_the_next_order_is_taken(tmp_path, timeout_s, error):
    async with diagnoser(tmp_path / "children", timeout_s=timeout_s) as diagnosing:
        for _ in range(2):
            answer = await diagnosing.ask({"real": {"path": str(tmp_path / "none.npz")}, "sim": None, "nominal": []})
            assert error in answer["error"].lower()
            assert answer["seconds"] >= 0.0
