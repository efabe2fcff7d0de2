from __future__ import annotations

import json
from dataclasses import replace

import click
import numpy as np
import pytest
from click.testing import CliRunner

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitStatus
from mavcal.calib.methods import METHODS
from mavcal.calib.methods.method import FindingKind, Method
from mavcal.calib.option import Option
from mavcal.calib.recording import Identity, ParameterEntry, ParameterTimeline, Recording
from mavcal.service.commands import fit_method
from mavcal.service.commands.fit_method import command_of
from tests.unit.api import samples
from tests.unit.commands.test_review import BLOCKED, PLAN

THERMAL = samples.fit()  # one offset is not determined
FIT = replace(
    THERMAL,
    method="gyro-rest",
    status=FitStatus.OK,
    model=replace(THERMAL.model, polynomial=None),
    covariance=np.diag([4e-6, 0.0, 1e-6, *[0.0] * 9]),
    undetermined=(),
    movements={},
    native={},
    quality={},
)
REFUSED = replace(FIT, status=FitStatus.REFUSED, message="it moved")


class Ran:
    """The command of a method that finds these fits, and what it was run with."""

    def __init__(self, monkeypatch, *fits, finds=FindingKind.CORRECTION, pool=False, options=()):
        self.options = None
        self.read = []
        self.fits = fits
        pooled = (lambda *_: ()) if pool else None
        method = Method("gyro-rest", "a rest", options, lambda *_: (), pooled, finds)
        recording = Recording((), identity=Identity("ardupilot", 2, (4, 7, 0), "00", 1, 1))
        self.recording = replace(recording, parameters=ParameterTimeline((ParameterEntry(0.0, "INS_GYR_ID", 7),)))
        monkeypatch.setattr(Method, "run_pooled", lambda _self, recordings, options: self._run(recordings, options))
        monkeypatch.setattr(fit_method, "read_recording", lambda *what: self.read.append(what) or self.recording)
        self.command = command_of(method)

    def _run(self, recordings, options):
        self.recordings, self.options = recordings, options
        return self.fits

    def __call__(self, *arguments):
        result = CliRunner().invoke(self.command, arguments, standalone_mode=False)
        if result.exception is not None:
            raise result.exception
        return result.return_value, result.stdout.splitlines(), result.stderr


@pytest.fixture
def ran(monkeypatch):
    return lambda *fits, **more: Ran(monkeypatch, *fits, **more)


def test_a_fit_is_shown_with_what_is_estimated(ran):
    code, lines, _ = ran(FIT)("a.csv")
    assert code == 0
    assert lines[0] == "gyro-rest gyro[1]: ok. one is open"
    assert [line.split() for line in lines[1:3]] == [  # what was held fixed has no line
        ["offset_x", "0.1", "+-", "0.002"],
        ["offset_z", "0.3", "+-", "0.001"],
    ]
    assert lines[3] == "  residual 0.001 rad/s over 4 of 5 samples"
    assert lines[4] == "  ! few samples"


def test_what_is_open_and_what_is_relative_is_said(ran):
    _, lines, _ = ran(replace(THERMAL, relative=True))("a.csv")
    assert any(line.split() == ["offset_z", "undetermined"] for line in lines)
    assert any(line.endswith("(relative to the calibration in force, which is not known)") for line in lines)


def test_a_refused_fit_says_why_and_nothing_else(ran):
    code, lines, _ = ran(FIT, REFUSED)("a.csv")
    assert code == 1
    assert lines[-1] == "gyro-rest gyro[1]: refused. it moved"


def test_options_that_are_not_given_are_the_methods_own(ran):
    options = (Option("gravity", float, 9.8, "length"), Option("model", ("ring", "sphere"), "ring", "form"))
    method = ran(FIT, options=options)
    method("a.csv")
    assert method.options == {}
    method("a.csv", "--gravity", "9.81", "--model", "sphere", "--from", "2")
    assert method.options == {"gravity": 9.81, "model": "sphere", "from": 2.0}
    with pytest.raises(click.BadParameter, match="'cube' is not one of"):
        method("a.csv", "--model", "cube")


def test_an_underscore_is_a_dash_on_the_command_line(ran):
    method = ran(FIT, options=(Option("fixture_sd", float, 0.0, "tilt"),))
    method("a.csv", "--fixture-sd", "0.5")
    assert method.options == {"fixture_sd": 0.5}


def test_one_file_unless_the_method_pools(ran):
    with pytest.raises(click.UsageError, match="gyro-rest takes one FILE, not 2"):
        ran(FIT)("a.csv", "b.csv")
    pooled = ran(FIT, pool=True)
    pooled("a.csv", "b.csv")
    assert len(pooled.recordings) == 2
    with pytest.raises(click.UsageError, match="either FILEs, or --face"):
        pooled("a.csv", "b.csv", "--face", "x-up=c.csv")


def test_faces_stand_for_a_file(ran):
    method = ran(FIT)
    method("--face", "x-up=c.csv", "--unit-accel", "g")
    [(file, faces, reading)] = method.read
    assert (file, faces, reading["unit_accel"]) == (None, (("x-up", "c.csv"),), "g")


def test_json_is_the_first_fit_with_all_of_them(ran):
    _, [line], _ = ran(FIT)("a.csv", "--json")
    alone = json.loads(line)
    assert (alone["method"], "fits" in alone) == ("gyro-rest", False)
    _, [line], _ = ran(FIT, REFUSED)("a.csv", "--json")
    both = json.loads(line)
    assert [fit["status"] for fit in both["fits"]] == ["ok", "refused"]
    assert both["status"] == "ok"


def test_another_form_stands_below_its_fit_and_a_refused_one_has_none(ran):
    _, lines, _ = ran(THERMAL, REFUSED)("a.csv", "--as", "ardupilot")
    assert "  ardupilot: parameters, for a sensor with the axes of the body" in lines
    assert "    INS_GYR2OFFS_X = 0.1" in lines
    assert any(line.startswith("    ! left out: offset_z: not determined") for line in lines)
    _, [line], _ = ran(FIT, REFUSED)("a.csv", "--as", "px4", "--json")
    assert ["converted" in fit for fit in json.loads(line)["fits"]] == [True, False]


@pytest.mark.parametrize("finds", [FindingKind.FIGURES, FindingKind.MOTORS])
def test_what_is_no_correction_has_no_other_form(ran, finds):
    method = ran(FIT, finds=finds)
    with pytest.raises(click.UsageError, match="has no other form"):
        method("a.csv", "--as", "px4")
    assert method.read == []


def test_a_header_of_c_is_written_and_counted(ran, tmp_path):
    out = tmp_path / "imu.h"
    code, _, said = ran(FIT)("a.csv", "--export", str(out))
    assert code == 0
    assert "gyro_1" in out.read_text()
    assert said == f"{out}: {len(out.read_text().splitlines())} lines\n"


def test_a_fit_is_told_although_it_cannot_be_exported(ran, tmp_path):
    out = tmp_path / "imu.h"
    code, lines, said = ran(THERMAL)("a.csv", "--export", str(out))
    assert (code, out.exists()) == (1, False)
    assert lines[0].startswith("thermal-poly gyro[1]: partial")
    assert said.startswith("mavcal: gyro_1 is not exported as an array")
    _, [line], _ = ran(THERMAL)("a.csv", "--export", str(out), "--json")
    assert json.loads(line)["export"]["error"].startswith("gyro_1 is not exported")


def test_a_file_that_cannot_be_written_is_said_after_the_fit(ran, tmp_path):
    out = tmp_path / "imu.h"
    out.mkdir()
    method = ran(FIT)
    with pytest.raises(click.BadParameter, match="is a directory"):
        method("a.csv", "--export", str(out))
    with pytest.raises(click.ClickException, match="cannot be written: Is a directory"):
        fit_method.write_file(out, "x")


@pytest.mark.parametrize(
    ("name", "finds", "said"),
    [
        ("imu.txt", FindingKind.CORRECTION, "a file ends in"),
        ("none/imu.h", FindingKind.CORRECTION, "there is no folder"),
        ("imu.h", FindingKind.FIGURES, "--json tells them"),
        ("imu.param", FindingKind.FIGURES, "--json tells them"),
        ("imu.h", FindingKind.DRIFT, "a constant array does not hold"),
        ("imu.h", FindingKind.MOTORS, "a constant array does not hold"),
    ],
)
def test_an_export_that_cannot_be_is_refused_before_anything_is_read(ran, tmp_path, name, finds, said):
    method = ran(FIT, finds=finds)
    with pytest.raises(click.UsageError, match=said):
        method("a.csv", "--export", str(tmp_path / name))
    assert method.read == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"identity": Identity()}, "does not say which autopilot"),
        ({"parameters": ParameterTimeline()}, "holds no parameters"),
    ],
)
def test_parameters_of_an_unknown_vehicle_are_refused_before_the_fit(ran, tmp_path, change, said):
    method = ran(FIT)
    method.recording = replace(method.recording, **change)
    with pytest.raises(click.UsageError, match=said):
        method("a.csv", "--export", str(tmp_path / "imu.param"))
    assert method.options is None
    assert method("a.csv", "--export", str(tmp_path / "imu.h"))[0] == 0  # an array of C is of no vehicle


@pytest.fixture
def composed(monkeypatch):
    """Fits are composed into this plan, and the fingerprint is that of the recording."""

    def as_plan(plan):
        def compose(fits, parameters, fingerprint):
            assert (len(fits), parameters) == (1, {"INS_GYR_ID": 7})
            assert fingerprint.autopilot == "ardupilot"
            return plan

        monkeypatch.setattr("mavcal.calib.firmware.compose.plan.compose", compose)

    return as_plan


def test_parameters_of_the_vehicle_of_the_recording_are_written_and_counted(ran, composed, tmp_path):
    out = tmp_path / "imu.params"
    composed(PLAN)
    code, _, said = ran(FIT)("a.csv", "--export", str(out))
    assert (code, said) == (0, f"{out}: 1 parameters\n")
    assert PLAN.changes[0].name in out.read_text()


def test_a_plan_that_is_blocked_is_not_exported(ran, composed, tmp_path):
    composed(BLOCKED)
    code, _, said = ran(FIT)("a.csv", "--export", str(tmp_path / "imu.params"))
    assert code == 1
    assert said == "mavcal: not exported: The offset is too large.\n"


@pytest.mark.parametrize("name", METHODS)
def test_every_method_has_a_command_with_its_own_options(name):
    made = command_of(METHODS[name])
    assert made.name == name
    assert {option.name for option in METHODS[name].options} <= {parameter.name for parameter in made.params}


def test_an_error_of_the_fit_is_an_error(ran):
    method = ran(FIT)

    def fails(*_):
        raise InvalidInputError("no gyro")

    method._run = fails
    with pytest.raises(InvalidInputError, match="no gyro"):
        method("a.csv")
