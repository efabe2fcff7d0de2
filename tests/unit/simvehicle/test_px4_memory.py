from __future__ import annotations

import numpy as np
import pytest

from mavcal.service.simvehicle.config import load_config
from mavcal.service.simvehicle.parameters import ParameterTable
from mavcal.service.simvehicle.px4_memory import SensorMemory
from mavcal.service.simvehicle.px4_parameters import ACCEL_IDS, GYRO_IDS, MAG_IDS, px4_table


@pytest.fixture
def table() -> ParameterTable:
    return ParameterTable(px4_table(load_config({"autopilot": "px4"})))


def loaded(table: ParameterTable, kind: str) -> SensorMemory:
    memory = SensorMemory(kind, {"ACC": ACCEL_IDS, "GYRO": GYRO_IDS, "MAG": MAG_IDS}[kind][0])
    memory.load(table)
    return memory


def set_and_load(table: ParameterTable, memory: SensorMemory, **values: float) -> None:
    for name, value in values.items():
        table.store(name, value)
    memory.load(table)


def test_accel_offsets_follow_the_measured_sequence(table: ParameterTable) -> None:
    m = loaded(table, "ACC")
    for value, in_force in ((0.005, 0.0), (0.02, 0.02), (0.025, 0.02), (0.05, 0.05), (0.057, 0.05), (0.0, 0.0)):
        set_and_load(table, m, CAL_ACC0_XOFF=value)
        assert m.offset[0] == pytest.approx(in_force), value


def test_the_norm_of_the_vector_change_counts(table: ParameterTable) -> None:
    m = loaded(table, "ACC")
    for axis in "XY":
        set_and_load(table, m, **{f"CAL_ACC0_{axis}OFF": 0.006})
        assert not m.offset.any()
    set_and_load(table, m, CAL_ACC0_ZOFF=0.006)
    assert m.offset == pytest.approx([0.006] * 3)


def test_small_scales_never_act_and_a_decoy_helps_only_in_memory(table: ParameterTable) -> None:
    m = loaded(table, "ACC")
    set_and_load(table, m, CAL_ACC0_XSCALE=1.004)
    assert m.scale[0] == 1.0
    set_and_load(table, m, CAL_ACC0_XSCALE=1.02)
    assert m.scale[0] == pytest.approx(1.02)
    set_and_load(table, m, CAL_ACC0_XSCALE=1.004)
    assert m.scale[0] == pytest.approx(1.004)
    assert loaded(table, "ACC").scale[0] == 1.0


def test_a_scale_that_is_not_positive_is_not_used(table: ParameterTable) -> None:
    m = loaded(table, "ACC")
    set_and_load(table, m, CAL_ACC0_XSCALE=-1.0)
    assert m.scale.tolist() == [1.0, 1.0, 1.0]


def test_the_first_gyro_offset_after_boot_is_taken_whatever_its_size(table: ParameterTable) -> None:
    m = loaded(table, "GYRO")
    set_and_load(table, m, CAL_GYRO0_XOFF=0.008)
    assert m.offset[0] == 0.0
    assert loaded(table, "GYRO").offset[0] == pytest.approx(0.008)


def test_magnetometer_thresholds(table: ParameterTable) -> None:
    m = loaded(table, "MAG")
    set_and_load(table, m, CAL_MAG0_XOFF=0.003, CAL_MAG0_ZSCALE=1.005, CAL_MAG0_YODIAG=0.005)
    assert (m.offset[0], m.scale[2], m.off_diagonal[1]) == (0.0, 1.0, 0.0)
    set_and_load(table, m, CAL_MAG0_XOFF=0.01, CAL_MAG0_ZSCALE=1.02, CAL_MAG0_YODIAG=0.02)
    assert (m.offset[0], m.scale[2], m.off_diagonal[1]) == pytest.approx((0.01, 1.02, 0.02))
    set_and_load(table, m, CAL_MAG0_XOFF=0.013)
    assert m.offset[0] == pytest.approx(0.01)


def test_a_slot_is_found_by_device_id_not_by_number(table: ParameterTable) -> None:
    set_and_load(table, SensorMemory("ACC", 0), CAL_ACC0_ID=ACCEL_IDS[1], CAL_ACC1_ID=ACCEL_IDS[0], CAL_ACC1_XOFF=0.3)
    m = loaded(table, "ACC")
    assert m.slot == 1
    assert m.offset[0] == pytest.approx(0.3)
    assert m.as_parameters()["CAL_ACC1_XOFF"] == pytest.approx(0.3)


def test_a_sensor_without_slot_is_uncalibrated(table: ParameterTable) -> None:
    table.store("CAL_ACC0_ID", 0)
    table.store("CAL_ACC0_XOFF", 0.3)
    m = loaded(table, "ACC")
    assert m.slot is None
    assert not m.offset.any()
    assert m.as_parameters() == {}


def test_values_that_are_not_finite_never_enter(table: ParameterTable) -> None:
    m = loaded(table, "ACC")
    set_and_load(table, m, CAL_ACC0_XOFF=np.nan)
    assert not m.offset.any()
