from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

EXPECTED_NAMES = """
INS_ACCOFFS_X INS_ACC2OFFS_Y INS_ACC3SCAL_Z INS_GYROFFS_X INS_GYR2OFFS_X INS_ACC_ID INS_GYR3_ID INS_ACC1_CALTEMP
INS_GYR2_CALTEMP INS_USE INS_USE3 INS_ENABLE_MASK INS_POS1_X INS_TCAL3_GYR3_Z INS_TCAL2_TMAX INS_TRIM_OPTION
INS_ACC_BODYFIX INS_STILL_THRESH INS_TCAL_OPTIONS AHRS_ORIENTATION AHRS_TRIM_X CUST_ROT1_ROLL COMPASS_OFS_X
COMPASS_OFS2_X COMPASS_DIA3_X COMPASS_ODI2_Z COMPASS_SCALE2 COMPASS_MOT_X COMPASS_MOTCT COMPASS_PMOT4_Z
COMPASS_PMOT_EXP COMPASS_DEV_ID8 COMPASS_PRIO3_ID COMPASS_ORIENT3 COMPASS_EXTERNAL COMPASS_EXTERN2
COMPASS_AUTO_ROT COMPASS_USE2 COMPASS_ENABLE COMPASS_LEARN COMPASS_CAL_FIT COMPASS_FLTR_RNG COMPASS_DEC
COMPASS_OFFS_MAX ARMING_ACCTHRESH ARMING_MAGTHRESH INS_GYR_CAL INS_GYRO_FILTER INS_ACCEL_FILTER
"""


def test_the_first_element_of_a_vector_echoes_all_three(bench: Any) -> None:
    b = bench("ardupilot")
    b.set("INS_ACCOFFS_X", 0.1)
    b.run(0.02)
    echoes = b.take("PARAM_VALUE")
    assert [m.param_id for m in echoes] == ["INS_ACCOFFS_X", "INS_ACCOFFS_Y", "INS_ACCOFFS_Z"]
    assert {m.param_index for m in echoes} == {65535}
    b.set("INS_ACCOFFS_Y", -0.05)
    b.run(0.02)
    assert [(m.param_id, m.param_value) for m in b.take("PARAM_VALUE")] == [("INS_ACCOFFS_Y", pytest.approx(-0.05))]


def test_echoes_are_late_and_go_to_every_link(bench: Any) -> None:
    b = bench("ardupilot", links=2)
    b.set("INS_GYR_CAL", 0.0)
    assert b.take("PARAM_VALUE") == []
    b.run(0.02)
    assert [m.param_id for m in b.take("PARAM_VALUE", 0)] == ["INS_GYR_CAL"]
    assert [m.param_id for m in b.take("PARAM_VALUE", 1)] == ["INS_GYR_CAL"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_not_a_number_is_met_with_silence(bench: Any, value: float) -> None:
    b = bench("ardupilot")
    b.set("INS_ACCOFFS_X", value)
    b.set("NO_SUCH_PARAM", 1.0)
    b.run(1.0)
    assert b.take("PARAM_VALUE") == []
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.0


@pytest.mark.parametrize(("sent", "stored"), [(0.7, 0), (0.995, 1), (2.99, 3), (-1.0, -1), (-0.7, 0), (200.0, 127)])
def test_integers_are_nudged_truncated_and_clamped_to_their_type(bench: Any, sent: float, stored: int) -> None:
    b = bench("ardupilot")
    b.set("COMPASS_LEARN", sent)
    b.run(0.02)
    assert [m.param_value for m in b.take("PARAM_VALUE")] == [float(stored)]


def test_ids_survive_the_cast_to_float(bench: Any) -> None:
    b = bench("ardupilot")
    b.read("INS_ACC_ID")
    b.run(0.2)
    assert [(m.param_value, m.param_type, m.param_index) for m in b.take("PARAM_VALUE")] == [(2753028.0, 6, 65535)]


def test_reads_are_answered_five_at_a_time_and_the_queue_holds_twenty(bench: Any) -> None:
    b = bench("ardupilot")
    for index in range(30):
        b.read("", index)
    b.run(0.101)
    assert [m.param_index for m in b.take("PARAM_VALUE")] == [0, 1, 2, 3, 4]
    b.run(2.0)
    assert [m.param_index for m in b.take("PARAM_VALUE")] == list(range(5, 20))


def test_the_list_is_complete_in_order_and_hides_switched_off_groups(bench: Any) -> None:
    b = bench("ardupilot")
    b.send(dialect.MAVLink_param_request_list_message(1, 1))
    b.run(2.0)
    listed = b.take("PARAM_VALUE")
    assert [m.param_index for m in listed] == list(range(listed[0].param_count))
    names = [m.param_id for m in listed]
    assert "INS_TCAL1_ENABLE" in names
    assert "INS_TCAL1_TMIN" not in names
    b.set("INS_TCAL1_ACC1_X", 7000.0)
    b.set("INS_TCAL1_ENABLE", 1.0)
    b.run(0.1)
    echo = b.take("PARAM_VALUE")
    assert echo[0].param_value == 7000.0
    assert echo[-1].param_count == listed[0].param_count + 20


def test_every_name_of_the_modelled_sensors_exists(bench: Any) -> None:
    table = bench("ardupilot").vehicle.table
    for name in EXPECTED_NAMES.split():
        assert name in table, name
    assert len(table.listing()) > 250


def test_unsaved_values_are_lost_by_a_power_failure_and_kept_by_a_commanded_reboot(bench: Any) -> None:
    b = bench("ardupilot", boot_s=0.1)
    b.set("INS_ACCOFFS_X", 0.2)
    b.run(0.1)
    b.vehicle.reboot(flush=False)
    b.run(0.2)
    assert b.vehicle.table["INS_ACCOFFS_X"].value == 0.0
    b.set("INS_ACCOFFS_X", 0.2)
    b.command(246, 1)
    b.run(0.3)
    assert b.vehicle.boots == 2
    assert b.vehicle.table["INS_ACCOFFS_X"].value == pytest.approx(0.2)


@pytest.mark.parametrize(("gyr_cal", "kept"), [(1.0, False), (0.0, True)])
def test_gyro_offsets_survive_a_reboot_only_if_boot_calibration_is_off(bench: Any, gyr_cal: float, kept: bool) -> None:
    b = bench("ardupilot", boot_s=0.1, gyro_noise=1e-5)
    b.set("INS_GYR_CAL", gyr_cal)
    b.set("INS_GYROFFS_X", 0.5)
    b.run(1.0)
    b.command(246, 1)
    b.run(0.3)
    offset = b.vehicle.table["INS_GYROFFS_X"].value
    truth = b.vehicle.world.truth.gyros[0]
    expected = 0.5 if kept else truth.offset[0]
    assert offset == pytest.approx(expected, abs=1e-4)
