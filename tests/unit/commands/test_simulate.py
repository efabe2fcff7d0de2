from __future__ import annotations

import json

import click
import numpy as np
import pytest
from click.testing import CliRunner

from mavcal.calib.logs.tables import read_table
from mavcal.calib.recording import Sensor
from mavcal.service.commands import simulate
from mavcal.service.commands.simulate import command


@pytest.fixture
def made(tmp_path, monkeypatch):
    """Makes a recording in an empty folder: the table, its truth, and what was said."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments, out="out.csv"):
        given = ["recording", "--out", out, "--truth", "truth.json", *arguments]
        result = CliRunner().invoke(command, given, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return read_table(tmp_path / out), json.loads((tmp_path / "truth.json").read_text()), result

    return run


REST = ("--motion", "rest", "--duration", "2", "--rate", "50", "--ideal")


def test_a_vehicle_at_rest_reads_gravity_and_the_field_of_its_place(made):
    recording, truth, _ = made(*REST)
    np.testing.assert_allclose(recording.channel(Sensor.ACCEL).values.mean(axis=0), [0.0, 0.0, -9.80665], atol=1e-6)
    np.testing.assert_allclose(recording.channel(Sensor.MAG).values.mean(axis=0), simulate._FIELD, atol=1e-6)
    assert (truth["motion"], truth["field_ned"]) == ("rest", list(simulate._FIELD))


def test_the_same_seed_makes_the_same_file_and_another_one_another(made, tmp_path):
    noisy = ("--motion", "rest", "--duration", "1", "--rate", "50")
    texts = []
    for seed in ("7", "7", "8"):
        made(*noisy, "--seed", seed)
        texts.append((tmp_path / "out.csv").read_text())
    assert texts[0] == texts[1] != texts[2]


def test_a_field_may_be_stated_in_the_frame_of_the_table(made):
    _, truth, _ = made(*REST, "--field", "1,2,3")
    assert truth["field_ned"] == [1.0, 2.0, 3.0]
    _, truth, _ = made(*REST, "--field", "1,2,3", "--frame", "enu")
    assert truth["field_ned"] == [2.0, 1.0, -3.0]  # given as east, north, up


@pytest.mark.parametrize("text", ["1,2", "1,2,3,4", "a,b,c", ""])
def test_a_field_is_three_numbers(made, text):
    with pytest.raises(click.BadParameter, match="is not 3 numbers with commas between"):
        made(*REST, "--field", text)


@pytest.mark.parametrize("given", [(), ("--motion", "rest", "--trajectory", "a.csv")])
def test_either_a_motion_or_a_trajectory(made, given):
    with pytest.raises(click.UsageError, match="one of --motion and --trajectory"):
        made(*given)


def test_a_trajectory_is_followed(made, tmp_path):
    t = np.arange(200) / 50.0
    rows = [f"{x:.3f},{np.cos(0.2 * x):.9f},{np.sin(0.2 * x):.9f},0,0" for x in t]
    (tmp_path / "attitude.csv").write_text("t,q_w,q_x,q_y,q_z\n" + "\n".join(rows) + "\n")
    recording, truth, _ = made("--trajectory", "attitude.csv", "--ideal")
    rates = recording.channel(Sensor.GYRO).values
    np.testing.assert_allclose(np.median(rates, axis=0), [0.4, 0.0, 0.0], atol=1e-3)
    assert truth["motion"] == "attitude.csv"


def test_the_sensors_may_be_those_of_a_file_of_parameters(made, tmp_path):
    (tmp_path / "sim.param").write_text("SIM_ACC1_BIAS_X 0.5\nSIM_ACC2_BIAS_X 0.9\n")
    for instance, bias in (("0", 0.5), ("1", 0.9)):
        recording, _, _ = made(*REST, "--params", "sim.param", "--instance", instance)
        assert recording.channel(Sensor.ACCEL).values[:, 0].mean() == pytest.approx(bias, abs=0.01)


def test_a_stream_is_as_coarse_as_mavlink(made):
    recording, _, _ = made(*REST[:-1], "--stream", "--seed", "3")
    mg = recording.channel(Sensor.ACCEL).values / 9.80665e-3
    np.testing.assert_allclose(mg, np.round(mg * 2) / 2, atol=0.02)  # the middle of a step of one mg


def test_a_file_that_cannot_be_written_is_said(made):
    with pytest.raises(click.ClickException, match="cannot be written: No such file"):
        made(*REST, out="none/out.csv")


def test_json_says_where_and_what(made):
    _, truth, result = made(*REST, "--json")
    told = json.loads(result.stdout)
    assert (told["out"], told["truth"], told["ignored"]) == ("out.csv", truth, [])
