"""``mavcal simulate recording``: tables that ``mavcal fit`` reads, and their truth."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.simulate import MOTIONS
from mavcal.service.cli import main
from mavcal.service.commands.simulate import MOTION_NAMES

Cli = Callable[..., tuple[int, Any, str]]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, Any, str]:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr()
        code = 0 if ended.value.code is None else int(ended.value.code)
        return code, json.loads(said.out) if "--json" in arguments else said.out, said.err

    return run


def simulated(cli: Cli, *arguments: str) -> dict[str, Any]:
    code, document, error = cli("simulate", "recording", *arguments, "--json")
    assert code == 0, error
    return document


def test_the_motions_of_the_help_are_those_there_are():
    assert tuple(MOTIONS) == MOTION_NAMES


def test_a_fit_finds_the_truth_within_its_uncertainty(cli):
    truth = simulated(cli, "--motion", "six-faces", "--seed", "3", "--out", "faces.csv", "--truth", "truth.json")[
        "truth"
    ]
    assert json.loads(Path("truth.json").read_text()) == truth
    code, fit, _ = cli("fit", "accel-six-face", "faces.csv", "--json")
    assert code == 0
    errors = np.array(fit["model"]["matrix"]) - truth["models"]["accel"]["matrix"]
    assert (np.abs(errors) < 4 * np.array(fit["sd"]["matrix"])).all()
    errors = np.array(fit["model"]["offset"]) - truth["models"]["accel"]["offset"]
    assert (np.abs(errors) < 4 * np.array(fit["sd"]["offset"])).all()


def test_the_same_seed_writes_the_same_file(cli):
    for name, seed in (("a.csv", "1"), ("b.csv", "1"), ("c.csv", "2")):
        simulated(cli, "--motion", "rest", "--duration", "2", "--seed", seed, "--out", name)
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes() != Path("c.csv").read_bytes()


def test_enu_tables_are_fitted_like_ned_ones(cli):
    common = ("--motion", "tumble", "--duration", "60", "--rate", "20", "--ideal")
    simulated(cli, *common, "--out", "ned.csv")
    simulated(cli, *common, "--out", "enu.csv", "--frame", "enu")
    assert Path("ned.csv").read_text() != Path("enu.csv").read_text()
    _, ned, _ = cli("fit", "mag-sphere", "ned.csv", "--json")
    _, enu, _ = cli("fit", "mag-sphere", "enu.csv", "--world", "enu", "--body", "flu", "--json")
    np.testing.assert_allclose(enu["model"]["offset"], ned["model"]["offset"], atol=1e-9)


def test_parameters_of_matlab_and_of_sitl_and_the_truth_of_another_run(cli):
    Path("imu.json").write_text(json.dumps({"accelparams": {"ConstantBias": [0.3, -0.2, 0.1]}}))
    Path("sitl.param").write_text("SIM_ACC1_BIAS_X,0.25\nSIM_ACC1_SCAL_X 1.25 # twice\nSIM_DRIFT_SPEED,0.05\n")
    rest = ("--motion", "rest", "--duration", "2", "--out", "r.csv")
    made = simulated(cli, *rest, "--params", "imu.json")["truth"]
    assert made["models"]["accel"]["offset"] == [-0.3, 0.2, -0.1]  # imuSensor's accelerometer has the other sign
    made = simulated(cli, *rest, "--params", "sitl.param")
    assert made["ignored"] == ["SIM_DRIFT_SPEED"]
    assert made["truth"]["models"]["accel"]["offset"][0] == 0.25
    assert made["truth"]["models"]["accel"]["matrix"][0][0] == pytest.approx(1.25)
    Path("again.json").write_text(json.dumps(made["truth"]["sensors"]))
    assert simulated(cli, *rest, "--params", "again.json")["truth"]["models"] == made["truth"]["models"]


def test_a_recorded_attitude_is_followed(cli):
    simulated(cli, "--motion", "figure-eight", "--ideal", "--out", "first.npz")
    simulated(cli, "--trajectory", "first.npz", "--ideal", "--out", "second.npz")
    with np.load("first.npz") as first, np.load("second.npz") as second:
        np.testing.assert_allclose(second["accel_x"], first["accel_x"], atol=1e-9)
        np.testing.assert_allclose(second["gyro_y"][5:-5], first["gyro_y"][5:-5], atol=2e-3)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--out", "x.csv"),
        ("--motion", "rest", "--trajectory", "y.csv", "--out", "x.csv"),
        ("--motion", "rest", "--out", "x.txt"),
        ("--motion", "rest", "--out", "x.csv", "--field", "1,2"),
        ("--motion", "rest", "--out", "x.csv", "--rate", "-1"),
        ("--motion", "rest", "--out", "x.csv", "--rate", "nan"),
        ("--motion", "rest", "--out", "x.csv", "--params", "none.json"),
        ("--motion", "rest", "--out", "no/where.csv"),
    ],
)
def test_wrong_use_is_said(cli, arguments):
    code, document, error = cli("simulate", "recording", *arguments, "--json")
    assert code == 2
    assert document["error"]["detail"] in error
