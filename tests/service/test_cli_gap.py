"""``mavcal gap``: the answer as text and JSON, the page, the remedy, and whether it helped."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavcal.calib.gap.export import Target
from mavcal.calib.simulate.document import stated_in
from mavcal.service.cli import main
from mavcal.service.commands.gap import TARGETS
from tests.service.gap_tables import BIAS, write_table

Cli = Callable[..., tuple[int, Any, str]]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Cli:
    """Run a command in an empty folder: its exit code, its JSON (else its text), its stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: str) -> tuple[int, Any, str]:
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        said = capsys.readouterr()
        assert "Traceback" not in said.err
        out = json.loads(said.out) if "--json" in arguments else said.out
        return int(ended.value.code or 0), out, said.err

    return run


def test_a_bias_is_named_told_drawn_and_exported(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "real.csv")
    outs = [arg for name in ("sim.parm", "sim.sdf", "sim.m", "sim.json") for arg in ("--export", name)]
    code, said, err = cli("gap", "--real", "real.csv", "--report", "out.html", *outs, "--json")
    assert code == 0
    assert said["verdict"] == "explained"
    assert [e["id"] for e in said["effects"]] == ["accel_bias"]
    assert said["effects"][0]["sim_patch"].keys() == {f"SIM_ACC1_BIAS_{a}" for a in "XYZ"}
    assert [(e["for"], e["written"]) for e in said["exports"]] == [
        ("sitl", True), ("gazebo", True), ("matlab", True), ("mavcal", True)
    ]  # fmt: skip
    assert all(e["doubtful"] == [] for e in said["exports"])
    for name in ("sim.parm", "sim.json"):  # both are read back as the sensor that was recorded
        errors = stated_in((tmp_path / name).read_text(), Path(name).suffix).suite.accel
        np.testing.assert_allclose(errors.bias, BIAS, atol=0.012)
    means = re.findall(r"<mean>(.*?)</mean>", (tmp_path / "sim.sdf").read_text())
    np.testing.assert_allclose([float(m) for m in means], np.array(BIAS) * [1, -1, -1], atol=0.012)
    assert "accel.ConstantBias = [-0.3" in (tmp_path / "sim.m").read_text()
    assert "<h1>Sim-to-real gap of real.csv</h1>" in (tmp_path / "out.html").read_text()
    assert "out.html" in err


@pytest.mark.long
def test_the_text_says_what_was_found(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "real.csv")
    write_table(tmp_path / "half.csv", (0.15, -0.1, 0.075), seed=9)
    code, text, _ = cli("gap", "--real", "real.csv", "--verify", "half.csv")
    assert code == 0
    assert text.startswith("explained: ")
    assert "a constant offset, accelerometer 1 (accel_bias)" in text
    assert re.search(r"bias\.x +0\.(29|30|31)\d* \+- 0\.00", text)
    assert "closes" in text
    left = float(re.search(r"accel_bias of instance 1: (\S+) % of its evidence is left", text)[1])
    assert left == pytest.approx(25.0, abs=5.0)  # half of the offset is left, a quarter of its nats


@pytest.mark.long
def test_the_remedied_simulator_leaves_nothing(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "real.csv")
    write_table(tmp_path / "again.csv", seed=9)
    _, said, _ = cli("gap", "--real", "real.csv", "--verify", "again.csv", "--json")
    found = said["verify"]
    assert found["verdict"] == "no_gap"
    assert found["effects"][0]["share"] == 0.0
    assert found["remaining"]["ci95"][1] < 0.001 * found["before"]["nats"]
    assert found["closed"] > 0.99


def test_no_gap_is_an_answer_and_has_no_remedy(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "null.csv", (0.0, 0.0, 0.0))
    code, said, err = cli("gap", "--real", "null.csv", "--export", "x.parm", "--json")
    assert (code, said["verdict"]) == (0, "no_gap")
    assert "there is no gap" in said["exports"][0]["reason"]
    assert not (tmp_path / "x.parm").exists()
    assert "not written" in err


def test_seconds_of_data_are_not_testable(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "short.csv", seconds=0.5)
    code, said, _ = cli("gap", "--real", "short.csv", "--json")
    assert (code, said["verdict"]) == (1, "not_testable")


@pytest.mark.parametrize("column", ["accel", "temperature"])
def test_a_sound_recording_that_nothing_can_be_compared_with_is_not_wrong_use(
    cli: Cli, tmp_path: Path, column: str
) -> None:
    head = "t,temperature" if column == "temperature" else "t,accel_x,accel_y,accel_z"
    rows = (f"{i / 50},{'20' if column == 'temperature' else '0.1,0,-9.8'}" for i in range(400))
    (tmp_path / "bare.csv").write_text("\n".join([head, *rows]))
    code, said, _ = cli("gap", "--real", "bare.csv", "--report", "out.html", "--json")
    assert (code, said["verdict"], said["tested"]) == (1, "not_testable", False)
    (gone,) = said["not_testable"]
    assert gone["need"]
    assert gone["reason"] in (tmp_path / "out.html").read_text()
    code, text, _ = cli("gap", "--real", "bare.csv")
    assert code == 1
    assert gone["need"] in text


@pytest.mark.long
def test_mappings_are_of_the_real_table_and_the_simulators_has_its_own(cli: Cli, tmp_path: Path) -> None:
    table = write_table(tmp_path / "real.csv").read_text().splitlines()
    (tmp_path / "real.csv").write_text("\n".join([table[0].replace("t,accel_x", "t,ax"), *table[1:]]))
    (tmp_path / "half.csv").write_text("\n".join([table[0].replace("t,accel_x", "t,sx"), *table[1:]]))
    _, said, _ = cli(
        *("gap", "--real", "real.csv", "--verify", "half.csv", "--map", "accel_x=ax", "--sim-map", "accel_x=sx"),
        "--json",
    )
    assert said["verdict"] == "explained"
    assert said["verify"]["verdict"] == "no_gap"


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((), "--real"),
        (("--real", "gone.csv"), "gone.csv"),
        (("--real", "real.csv", "--export", "x.xyz"), ".parm"),
        (("--real", "real.csv", "--export", "x.sdf", "--for", "vehicle"), "vehicle"),
        (("--real", "real.csv", "--sim", "gone.bin"), "gone.bin"),
        (("--real", "real.csv", "--export", "gone/x.parm"), "no folder gone"),
        (("--real", "real.csv", "--report", "gone/x.html"), "no folder gone"),
    ],
)
def test_wrong_use_is_told_before_anything_is_computed(
    cli: Cli, tmp_path: Path, arguments: tuple[str, ...], word: str
) -> None:
    write_table(tmp_path / "real.csv", seconds=2.0)
    code, _, err = cli("gap", *arguments)
    assert code == 2
    assert word in err


@pytest.mark.long
def test_the_new_recording_is_named_where_it_cannot_be_diagnosed(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "real.csv")
    write_table(tmp_path / "short.csv", seconds=2.0)
    rows = (tmp_path / "short.csv").read_text().replace("ref_accel", "gyro")
    (tmp_path / "bare.csv").write_text(rows)
    _, said, _ = cli("gap", "--real", "real.csv", "--verify", "short.csv", "--json")
    assert any(text.startswith("the new recording: accel") for text in said["verify"]["warnings"])
    code, said, _ = cli("gap", "--real", "real.csv", "--verify", "bare.csv", "--json")
    assert code == 2
    assert "the new recording of the simulator" in said["error"]["detail"]


def test_what_was_not_compared_is_told_with_the_answer(cli: Cli, tmp_path: Path) -> None:
    table = write_table(tmp_path / "real.csv").read_text().splitlines()
    head = table[0] + ",gyro_x,gyro_y,gyro_z,ref_gyro_x,ref_gyro_y,ref_gyro_z"
    rows = [f"{row},0,0,0,{np.sin(i / 9)},{np.cos(i / 9)},0.1" for i, row in enumerate(table[1:])]
    (tmp_path / "real.csv").write_text("\n".join([head, *rows]))
    _, text, _ = cli("gap", "--real", "real.csv")
    assert "Not compared, at least in part: gyroscope" in text.splitlines()[1]


def test_a_table_has_no_calibration_to_write(cli: Cli, tmp_path: Path) -> None:
    write_table(tmp_path / "real.csv")
    _, said, _ = cli("gap", "--real", "real.csv", "--export", "x.param", "--for", "vehicle", "--json")
    assert "parameters" in said["exports"][0]["reason"]


def test_the_targets_are_those_of_the_exports() -> None:
    assert tuple(t.value for t in Target) == TARGETS
