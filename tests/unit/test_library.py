"""The library by itself: a small surface, loaded when it is asked for, and files of what came of a recording."""

from __future__ import annotations

import ast
import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mavcal.calib as library
from mavcal.calib.errors import FirmwareError, InvalidInputError
from mavcal.calib.firmware.export import ParameterFormat
from mavcal.calib.gap.schema import GapReport, GapVerdict, Inputs
from mavcal.calib.recording import Channel, Identity, ParameterTimeline, Recording, Sensor, Stage
from tests.parameter_files import read_parameters
from tests.unit.firmware.conftest import ardupilot_parameters  # noqa: F401 - a fixture

STUB = Path(library.__file__).with_suffix(".pyi")


@pytest.fixture(scope="module")
def compass() -> Recording:
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(1500, 3))
    values = 50.0 * directions / np.linalg.norm(directions, axis=1)[:, None] + [12.0, -7.0, 3.0]
    values += 0.3 * rng.normal(size=values.shape)
    return Recording((Channel(Sensor.MAG, 0, np.arange(1500) / 50, values, "uT", Stage.RAW, "test"),))


def test_every_public_name_is_there_and_the_types_name_the_same_places():
    for name in library.__all__:
        assert getattr(library, name) is not None
    assert set(library.__all__) <= set(dir(library))
    stated = {
        (alias.asname or alias.name): (node.module, alias.name)
        for node in ast.parse(STUB.read_text(encoding="utf-8")).body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("mavcal.calib")
        for alias in node.names
    }
    assert stated == {name: (f"mavcal.calib.{room}", own) for name, (room, own) in library._PUBLIC.items()}
    with pytest.raises(AttributeError, match="no_such"):
        _ = library.no_such


def test_the_package_alone_loads_nothing_heavy():
    code = "import sys, mavcal.calib; bad = {'numpy', 'scipy', 'markupsafe'} & set(sys.modules); assert not bad, bad"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_fit_takes_the_options_of_its_method_and_refuses_others(compass):
    (fit,) = library.fit_recording(compass, "mag-sphere", instance=0)
    np.testing.assert_allclose(fit.model.offset, [12.0, -7.0, 3.0], atol=0.1)
    assert library.bare(compass) == compass
    with pytest.raises(InvalidInputError, match="no option wrong"):
        library.fit_recording(compass, "mag-sphere", wrong=1)
    with pytest.raises(InvalidInputError, match=r"no method 'mag-spere'; the methods are .*mag-sphere"):
        library.fit_recording(compass, "mag-spere")


def test_fits_are_saved_as_json_and_as_c_and_a_table_gives_no_parameters(compass, tmp_path):
    fits = library.fit_recording(compass, "mag-sphere")
    assert library.save_fits(fits, tmp_path / "fit.json") == 1
    assert json.loads((tmp_path / "fit.json").read_text())[0]["method"] == "mag-sphere"
    assert library.save_fits(fits, tmp_path / "fit.h") == 1
    assert "12.0" in (tmp_path / "fit.h").read_text() or "-1" in (tmp_path / "fit.h").read_text()
    with pytest.raises(InvalidInputError, match="needs a recording with the vehicle's parameters"):
        library.save_fits(fits, tmp_path / "fit.param", compass)
    assert not (tmp_path / "fit.param").exists()


def test_a_report_is_saved_by_the_ending_of_its_file(compass, tmp_path):
    report = GapReport(Inputs(None, None, 100.0, 60.0, "pose", 0.1, "", {}, "0"), GapVerdict.NO_GAP)
    assert library.save_report(report, tmp_path / "gap.html") == ()
    assert "No difference beyond the noise" in (tmp_path / "gap.html").read_text()
    with pytest.raises(InvalidInputError, match="needs the recording that was diagnosed"):
        library.save_report(report, tmp_path / "gap.parm")
    with pytest.raises(InvalidInputError, match="an export ends in"):
        library.save_report(report, tmp_path / "gap.xyz", compass)


def test_a_parameter_file_starts_from_the_parameters_of_the_log(compass, tmp_path, ardupilot_parameters):  # noqa: F811
    identity = Identity(autopilot="ardupilot", firmware=(4, 5, 7), uid="ab")
    log = dataclasses.replace(
        compass,
        identity=identity,
        parameters=ParameterTimeline.constant({**ardupilot_parameters, "COMPASS_OFS_X": 0.0}),
    )
    (fit,) = library.fit_recording(log, "mag-ellipsoid")
    written = library.save_fits([fit], tmp_path / "compass.param", log)
    values = read_parameters((tmp_path / "compass.param").read_text(), ParameterFormat.PARAM)
    assert written >= len(values) > 3
    assert values["COMPASS_OFS_X"] == pytest.approx(-120.0, abs=3.0)  # mGauss, added by the firmware
    with pytest.raises(FirmwareError, match="a parameter file ends in"):
        library.save_fits([fit], tmp_path / "compass.txt", log)
