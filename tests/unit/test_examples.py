"""The examples run as scripts, find what was put in, and leave the files that their page names."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from examples.made import OFFSET, REAL
from mavcal.calib.firmware.export import ParameterFormat
from tests.parameter_files import read_parameters

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted(p.stem for p in (ROOT / "examples").glob("*.py") if p.stem not in {"__init__", "made"})


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    def running(name: str) -> str:
        monkeypatch.chdir(tmp_path)
        runpy.run_module(f"examples.{name}", run_name="__main__")
        return capsys.readouterr().out

    return running


def test_a_first_look_writes_pictures_and_a_fit(run, tmp_path):
    said = run("first_look")
    assert "mag-ellipsoid of mag 1: ok" in said
    for name in ("first-look", "first-fit"):
        assert (tmp_path / f"{name}.svg").read_text(encoding="utf-8").startswith("<svg")
    assert json.loads((tmp_path / "compass.json").read_text())[0]["status"] == "ok"
    assert (tmp_path / "compass.h").stat().st_size > 100


def test_a_compass_from_a_flight_finds_its_offset(run, tmp_path):
    said = run("compass_from_flight")
    assert "mag-flight of mag 1: ok" in said
    assert "9 parameters" in said
    values = read_parameters((tmp_path / "compass.param").read_text(), ParameterFormat.PARAM)
    found = [-0.1 * values[f"COMPASS_OFS_{axis}"] for axis in "XYZ"]  # uT; the firmware adds it, in mGauss
    np.testing.assert_allclose(found, OFFSET, atol=1.2)


@pytest.mark.long
def test_a_gap_diagnosis_names_both_effects_with_their_size(run, tmp_path):
    said = run("gap_diagnosis")
    assert "Gap: explained, 2 effects" in said
    iron = [float(x) for x in re.findall(r"mag_hard_iron +hard_iron\.\w +(-?[\d.]+) \(", said)]
    np.testing.assert_allclose(iron, REAL.mag.bias, atol=0.1)
    assert "accel_temp_linear" in (tmp_path / "gap.html").read_text()
    assert (tmp_path / "gap.svg").stat().st_size > 10_000


def test_every_example_is_in_cells_and_on_the_page():
    page = (ROOT / "docs" / "library.md").read_text(encoding="utf-8")
    assert len(EXAMPLES) == 3
    for name in EXAMPLES:
        text = (ROOT / "examples" / f"{name}.py").read_text(encoding="utf-8")
        cells = [cell.partition("\n")[2].strip() for cell in text.split("\n# %%")[1:]]
        assert len(cells) >= 4
        for cell in cells:
            assert cell in page, f"docs/library.md does not show this cell of examples/{name}.py:\n{cell}"
