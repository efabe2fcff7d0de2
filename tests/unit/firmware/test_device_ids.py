from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavcal.calib.firmware.device_ids import decode_device_id
from mavcal.calib.recording import Sensor


@pytest.mark.parametrize(
    ("autopilot", "sensor", "device_id", "kind", "bus"),
    [
        ("px4", Sensor.GYRO, 1310988, "simulated", ("simulation", 1, 1)),
        ("px4", Sensor.ACCEL, 0x26000A, "ICM-42688", ("SPI", 1, 0)),
        ("px4", Sensor.MAG, 0x060E09, "IST8310", ("I2C", 1, 14)),
        ("ardupilot", Sensor.ACCEL, 0x34000A, "ICM-42688", ("SPI", 1, 0)),
        ("ardupilot", Sensor.MAG, 0x0A0E09, "IST8310", ("I2C", 1, 14)),
        ("ardupilot", Sensor.MAG, 97539, "DroneCAN", ("DroneCAN", 0, 125)),
        ("ardupilot", Sensor.GYRO, 0xFE000A, "type 0xfe", ("SPI", 1, 0)),
        ("other", Sensor.GYRO, 0x26000A, "type 0x26", ("", 1, 0)),
    ],
)
def test_an_id_says_part_and_place(
    autopilot: str, sensor: Sensor, device_id: int, kind: str, bus: tuple[str, int, int]
) -> None:
    part = decode_device_id(autopilot, sensor, device_id)
    assert (part.type, (part.bus, part.bus_number, part.address)) == (kind, bus)


def test_one_number_is_two_parts_on_the_two_autopilots() -> None:
    assert {decode_device_id(a, Sensor.GYRO, 0x28000A).type for a in ("ardupilot", "px4")} == {"ICM-20689", "ICM-20948"}


@given(st.sampled_from(["ardupilot", "px4", "other"]), st.integers(-(2**31), 2**31 - 1), st.sampled_from(Sensor))
def test_any_parameter_can_be_read(autopilot: str, device_id: int, sensor: Sensor) -> None:
    part = decode_device_id(autopilot, sensor, device_id)
    assert part.type
    packed = part.bus_number << 3 | part.address << 8 | part.type_number << 16
    assert packed == device_id & 0xFFFFFFF8
