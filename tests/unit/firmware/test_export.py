from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib.errors import FirmwareError
from mavcal.calib.firmware.export import (
    MAV_PARAM_TYPE,
    ParameterFormat,
    number,
    write_export,
    write_plan,
)
from mavcal.calib.firmware.plan import Change, Fingerprint, ParameterKind, WritePlan
from tests.parameter_files import read_parameters

FINE = float(np.float32(1.2345678e-7))
PLAN = WritePlan(
    Fingerprint("px4", "ab", "1.17.0", ()),
    "0" * 64,
    (
        Change("SENS_IMU_AUTOCAL", 1, 0, ParameterKind.INT32, "for this session", session=True),
        Change("TC_A0_X3_0", None, FINE, ParameterKind.REAL32, "drift", 1e-9, "m/s2/degC^3"),
        Change("CAL_ACC0_XOFF", 0.05, float(np.float32(0.31)), ParameterKind.REAL32, "offset", 1e-3, "m/s2"),
        Change("TC_A_ENABLE", 0, 1, ParameterKind.INT32, "use it"),
        Change("CAL_ACC0_ID", 0, 16777217, ParameterKind.INT32, "its id"),
    ),
    warnings=("a warning\nin two lines",),
)


@pytest.mark.parametrize("form", list(ParameterFormat))
def test_what_is_written_is_read_back_bit_by_bit_without_session_settings(form):
    values = read_parameters(write_plan(PLAN, form), form)
    assert list(values) == ["TC_A0_X3_0", "CAL_ACC0_XOFF", "TC_A_ENABLE", "CAL_ACC0_ID"]
    assert np.float32(values["TC_A0_X3_0"]) == np.float32(FINE)
    assert np.float32(values["CAL_ACC0_XOFF"]) == np.float32(0.31)
    assert values["CAL_ACC0_ID"] == 16777217


def test_the_three_formats_to_the_letter():
    lines = {form: write_plan(PLAN, form).splitlines() for form in ParameterFormat}
    assert "CAL_ACC0_XOFF,0.31" in lines[ParameterFormat.PARAM]
    assert "# was 0.05, sd 0.001: offset" in lines[ParameterFormat.PARAM]
    assert "CAL_ACC0_XOFF    0.31  # was 0.05, sd 0.001: offset" in lines[ParameterFormat.PARM]
    assert "1\t1\tCAL_ACC0_XOFF\t0.31\t9" in lines[ParameterFormat.PARAMS]
    assert "1\t1\tCAL_ACC0_ID\t16777217\t6" in lines[ParameterFormat.PARAMS]
    assert "# was not listed, sd 1e-09: drift" in lines[ParameterFormat.PARAMS]


@pytest.mark.parametrize("kind", list(ParameterKind))
def test_every_kind_has_its_number_of_the_wire(kind):
    assert MAV_PARAM_TYPE[kind] == getattr(dialect, f"MAV_PARAM_TYPE_{kind.name}")


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_every_float32_survives_its_text(value):
    assert np.float32(float(number(value))) == np.float32(value)


def test_a_blocked_plan_is_not_exported():
    blocked = WritePlan(PLAN.fingerprint, PLAN.snapshot_sha256, PLAN.changes, blockers=("out of range",))
    with pytest.raises(FirmwareError, match="out of range"):
        write_plan(blocked, ParameterFormat.PARAM)


@pytest.mark.parametrize("form", list(ParameterFormat))
def test_the_ending_chooses_the_format(tmp_path, form):
    path = tmp_path / f"plan.{form}"
    write_export(PLAN, path)
    assert path.read_text() == write_plan(PLAN, form)
    with pytest.raises(FirmwareError, match=r"\.param, \.parm, \.params"):
        write_export(PLAN, tmp_path / "plan.txt")


def test_the_head_names_the_plan_its_board_and_what_to_mind():
    fingerprint = Fingerprint("px4", "ab", "1.17.0", (("gyro0", 1310988),))
    head = write_plan(dataclasses.replace(PLAN, fingerprint=fingerprint), ParameterFormat.PARAM).splitlines()[:5]
    assert all(line.startswith("# ") for line in head)
    assert head[0].endswith("px4 1.17.0")
    assert head[1].startswith("# plan ")
    assert head[2].endswith("board ab")
    assert "gyro0" in head[3]
    assert "1310988" in head[3]
    assert head[4] == f"# {' '.join(PLAN.warnings[0].split())}"
    nameless = dataclasses.replace(PLAN, fingerprint=Fingerprint("px4", "", "", ()))
    head = write_plan(nameless, ParameterFormat.PARAM).splitlines()
    assert head[0].endswith("px4")
    assert "not known" in head[2]


def test_only_qgroundcontrols_file_has_its_table_head():
    for form in ParameterFormat:
        text = write_plan(PLAN, form)
        assert ("# Onboard" in text) == (form == ParameterFormat.PARAMS)
        assert ("# Vehicle-Id" in text) == (form == ParameterFormat.PARAMS)
