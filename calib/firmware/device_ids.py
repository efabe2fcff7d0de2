"""The unique id of a flight controller, and the device id of a part: bus, address and type (FLIGHT_CONTROLLERS 1.5).

Both firmwares pack a device id alike and number the types differently, so an id is read with its autopilot's table. It
does not identify a single part: an identical board has the same ids.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from mavcal.calib.recording import Sensor

_CAN = 3
"""The bus type under which ArduPilot numbers sensors instead of types."""
_BUSES: Final = MappingProxyType(
    {
        "ardupilot": ("", "I2C", "SPI", "DroneCAN", "SITL", "MSP", "serial"),
        "px4": ("", "I2C", "SPI", "DroneCAN", "simulation", "serial", "MAVLink"),
    }
)
"""Names by bus type (AP ``AP_HAL/Device.h``, PX4 ``Device.hpp``)."""


def _uid(text: bytes) -> int:
    """Words 1 and 2 of a BOARD_OVERRIDE_UUID."""
    return int.from_bytes(text[4:8], "little") << 32 | int.from_bytes(text[8:12], "little")


SIMULATION_UID: Final = _uid(b"SIMULATIONID0000")
SHARED_UIDS: Final = (
    SIMULATION_UID,
    *map(_uid, (b"RPIID00000000000", b"MODALAIVOXL20000", b"BBBLUEID00000000", b"BRNAVID000000000")),
)
"""The uid that PX4 gives where a board has none of its own (boards/*/src/board_config.h, mavlink_main.cpp)."""
_SYSTEMS: Final = 0xFF


def is_simulation_id(uid: int) -> bool:
    """Whether it is the uid of PX4's simulator, which adds its system id less one (mavlink_main.cpp)."""
    return 0 <= uid - SIMULATION_UID <= _SYSTEMS


def unit_id(autopilot: str | None, uid2: bytes, uid: int) -> str | None:
    """Hexadecimal id without trailing zeros; None if not unique: zero, all ones, or an id shared by boards of a kind.

    PX4's simulator adds its system id less one to both numbers (mavlink_main.cpp, send_autopilot_capabilities): two of
    them with one system id say the same.
    """
    significant = uid2[1:] if autopilot == "px4" else uid2
    if any(significant) and set(uid2) != {0xFF}:
        return uid2.rstrip(b"\0").hex()
    shared = any(0 <= uid - base <= _SYSTEMS for base in SHARED_UIDS)
    return f"{uid:016x}" if uid and not shared else None


def _table(text: str) -> Mapping[int, str]:
    pairs = (entry.split() for entry in text.split(","))
    return MappingProxyType({int(number, 16): name for number, name in pairs})


_ARDUPILOT_COMPASS: Final = _table(
    "01 HMC5883, 02 LSM303D, 04 AK8963, 05 BMM150, 06 LSM9DS1, 07 HMC5883, 08 LIS3MDL, 09 AK09916, 0a IST8310, "
    "0b ICM-20948, 0c MMC3416, 0d QMC5883L, 0e MAG3110, 0f SITL, 10 IST8308, 11 RM3100, 12 RM3100, 13 MMC5883, "
    "14 AK09918, 15 AK09915, 16 QMC5883P, 17 BMM350"
)
"""AP ``Tools/scripts/decode_devid.py`` at 00ab0f7."""
_ARDUPILOT_IMU: Final = _table(
    "09 BMI160, 10 L3G4200D, 11 LSM303D, 12 BMA180, 13 MPU-6000, 16 MPU-9250, 17 IIS328DQ, 21 MPU-6000, 22 L3GD20, "
    "24 MPU-9250, 25 I3G4250D, 26 LSM9DS1, 27 ICM-20789, 28 ICM-20689, 29 BMI055, 2a SITL, 2b BMI088, 2c ICM-20948, "
    "2d ICM-20648, 2e ICM-20649, 2f ICM-20602, 30 ICM-20601, 31 ADIS1647x, 32 serial, 33 ICM-40609, 34 ICM-42688, "
    "35 ICM-42605, 36 ICM-40605, 37 IIM-42652, 38 BMI270, 39 BMI085, 3a ICM-42670, 3b ICM-45686, 3c SCHA63T"
)
"""The same."""
_PX4: Final = _table(
    "01 HMC5883, 03 simulated, 04 AK8963, 05 LIS3MDL, 06 IST8310, 07 RM3100, 08 QMC5883L, 09 AK09916, 0a VCM1193L, "
    "0b IST8308, 0d MMC5983MA, 0e IIS2MDC, 0f QMC5883P, 11 LSM303D, 12 LSM6DSV, 14 simulated, 21 MPU-6000, "
    "22 L3GD20, 24 MPU-9250, 25 ICM-20649, 26 ICM-42688, 27 ICM-40609, 28 ICM-20948, 29 ICM-42605, 2a ICM-42670, "
    "2b IIM-42652, 2c IAM-20680HP, 2d ICM-42686, 2e IIM-42653, 33 MPU-6050, 34 ICM-45686, 35 MPU-6050, 36 MPU-6500, "
    "37 BMI270, 38 ICM-20602, 3a ICM-20608, 3c ICM-20689, 41 BMI055, 42 BMI055, 43 BMM150, 44 LSM9DS1, 45 LSM9DS1, "
    "52 FXOS8701C, 54 FXAS2100C, 57 ADIS16448, 58 ADIS16470, 59 ADIS16477, 5a ADIS16507, 5b SCH16T, 5c ADIS16607, "
    "5d ADIS1650x, 61 LSM303AGR, 62 LSM303AGR, 63 ADIS16497, 66 BMI088, 6a BMI088, 6c BMI085, 6d BMI085, "
    "80 DroneCAN, 86 DroneCAN, 87 DroneCAN, 88 DroneCAN, e1 VN-100, e2 VN-200, e3 VN-300, e5 BMM350, e9 ILabs, "
    "ea MicroStrain, eb BAHRS, ec SBG"
)
"""PX4 ``src/drivers/drv_sensor.h`` at 023ba6e: one table for all sensors."""


@dataclass(frozen=True)
class DevicePart:
    """A decoded device id."""

    bus: str
    """``I2C``, ``SPI`` ...; empty: a bus type that is not known."""
    bus_number: int
    address: int
    """On the bus: of a chip on I2C, of a chip select on SPI, of a node on DroneCAN."""
    type_number: int
    type: str
    """Name of the part; ``type 0x..`` where the table has none, ``DroneCAN`` where ArduPilot does not say."""


def decode_device_id(autopilot: str, sensor: Sensor, device_id: int) -> DevicePart:
    """Decode a device id; `autopilot` as in :class:`calib.recording.Identity`.

    >>> decode_device_id("px4", Sensor.GYRO, 1310988).type
    'simulated'
    """
    device = int(device_id) & 0xFFFFFFFF  # parameters are signed
    bus_type, number = device & 0x07, device >> 16
    buses = _BUSES.get(autopilot, ())
    bus = buses[bus_type] if bus_type < len(buses) else ""
    tables = {"ardupilot": _ARDUPILOT_COMPASS if sensor == Sensor.MAG else _ARDUPILOT_IMU, "px4": _PX4}
    if autopilot == "ardupilot" and bus_type == _CAN:
        name = "DroneCAN"
    else:
        name = tables.get(autopilot, {}).get(number, f"type 0x{number:02x}")
    return DevicePart(bus, device >> 3 & 0x1F, device >> 8 & 0xFF, number, name)
