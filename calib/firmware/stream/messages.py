"""Contents of each inertial message of each autopilot (FLIGHT_CONTROLLERS 2.1, 2.2, 9, 10)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from pymavlink.dialects.v20 import ardupilotmega as dialect

from mavcal.calib import STANDARD_GRAVITY
from mavcal.calib.recording import Rounding, Sensor, Stage

RAW_IMU: Final[int] = dialect.MAVLINK_MSG_ID_RAW_IMU
SCALED_IMU: Final[int] = dialect.MAVLINK_MSG_ID_SCALED_IMU
SCALED_IMU2: Final[int] = dialect.MAVLINK_MSG_ID_SCALED_IMU2
SCALED_IMU3: Final[int] = dialect.MAVLINK_MSG_ID_SCALED_IMU3
HIGHRES_IMU: Final[int] = dialect.MAVLINK_MSG_ID_HIGHRES_IMU

COMPASS_WINDOW: Final = MappingProxyType({"ardupilot": 0.1, "px4": 0.0})
"""What the stream's compass averages over, s: ArduPilot reads at 10 Hz and averages what the sensor gave meanwhile; PX4
streams single samples."""


@dataclass(frozen=True)
class MessageSensor:
    """One sensor in a message."""

    sensor: Sensor
    factor: float
    """Unit of the channel for one unit of the field; for whole-number fields also the quantum."""
    rounding: Rounding
    stage: Stage
    bits: int = 0
    """``fields_updated`` bits that must be set for the sample to be new; 0: the message has no such flags."""

    @property
    def unit(self) -> str:
        """Unit of the channel."""
        return UNITS[self.sensor]

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the payload fields."""
        return FIELDS[self.sensor]

    @property
    def quantum(self) -> float:
        """Width of a bin of the channel, in its unit."""
        return 0.0 if self.rounding == Rounding.NONE else self.factor


@dataclass(frozen=True)
class InertialMessage:
    """A message that carries an inertial unit, a compass, or both."""

    message_id: int
    instance: int
    """Instance of the inertial unit and of the compass; ``by_id``: of the compass only."""
    readings: tuple[MessageSensor, ...]
    read_s: float
    """Period at which the firmware reads the compass, in s; in between the message repeats it."""
    by_id: bool = False
    """The field ``id`` says which inertial unit it is."""

    @property
    def name(self) -> str:
        """Name of the message."""
        return str(dialect.mavlink_map[self.message_id].msgname)


UNITS: Final[Mapping[Sensor, str]] = MappingProxyType(
    {Sensor.ACCEL: "m/s2", Sensor.GYRO: "rad/s", Sensor.MAG: "uT", Sensor.TEMPERATURE: "degC"}
)
FIELDS: Final[Mapping[Sensor, tuple[str, ...]]] = MappingProxyType(
    {
        Sensor.ACCEL: ("xacc", "yacc", "zacc"),
        Sensor.GYRO: ("xgyro", "ygyro", "zgyro"),
        Sensor.MAG: ("xmag", "ymag", "zmag"),
        Sensor.TEMPERATURE: ("temperature",),
    }
)

MG: Final = STANDARD_GRAVITY / 1000.0
MRAD_S: Final = 1e-3
MGAUSS_UT: Final = 0.1
GAUSS_UT: Final = 100.0
CDEGC: Final = 0.01


def _whole_numbers(inertial: Stage, mag: Stage, temperature: Rounding) -> tuple[MessageSensor, ...]:
    return (
        MessageSensor(Sensor.ACCEL, MG, Rounding.TOWARD_ZERO, inertial),
        MessageSensor(Sensor.GYRO, MRAD_S, Rounding.TOWARD_ZERO, inertial),
        MessageSensor(Sensor.MAG, MGAUSS_UT, Rounding.TOWARD_ZERO, mag),
        MessageSensor(Sensor.TEMPERATURE, CDEGC, temperature, Stage.RAW),
    )


def _floats(inertial: Stage, mag: Stage, *, flagged: bool) -> tuple[MessageSensor, ...]:
    # no temperature: the field holds the barometer's or the air data's, never the inertial unit's
    accel, gyro, field = (0b111, 0b111000, 0b111000000) if flagged else (0, 0, 0)
    return (
        MessageSensor(Sensor.ACCEL, 1.0, Rounding.NONE, inertial, accel),
        MessageSensor(Sensor.GYRO, 1.0, Rounding.NONE, inertial, gyro),
        MessageSensor(Sensor.MAG, GAUSS_UT, Rounding.NONE, mag, field),
    )


# ArduPilot: corrected and low-pass filtered; compass corrected, the mean over the 100 ms between two reads.
_ARDUPILOT = _whole_numbers(Stage.FILTERED, Stage.CORRECTED, Rounding.TOWARD_ZERO)
# PX4: mean of one integration interval, corrected; the compass is sensor_mag as the driver gave it.
_PX4 = _whole_numbers(Stage.CORRECTED, Stage.RAW, Rounding.NEAREST)

INERTIAL: Final[Mapping[str, Mapping[int, InertialMessage]]] = MappingProxyType(
    {
        "ardupilot": MappingProxyType(
            {
                RAW_IMU: InertialMessage(RAW_IMU, 0, _ARDUPILOT, 0.1),
                SCALED_IMU: InertialMessage(SCALED_IMU, 0, _ARDUPILOT, 0.1),
                SCALED_IMU2: InertialMessage(SCALED_IMU2, 1, _ARDUPILOT, 0.1),
                SCALED_IMU3: InertialMessage(SCALED_IMU3, 2, _ARDUPILOT, 0.1),
                HIGHRES_IMU: InertialMessage(
                    HIGHRES_IMU, 0, _floats(Stage.FILTERED, Stage.CORRECTED, flagged=False), 0.1, by_id=True
                ),
            }
        ),
        "px4": MappingProxyType(
            {
                SCALED_IMU: InertialMessage(SCALED_IMU, 0, _PX4, 0.02),
                SCALED_IMU2: InertialMessage(SCALED_IMU2, 1, _PX4, 0.02),
                SCALED_IMU3: InertialMessage(SCALED_IMU3, 2, _PX4, 0.02),
                HIGHRES_IMU: InertialMessage(
                    HIGHRES_IMU, 0, _floats(Stage.DEBIASED, Stage.DEBIASED, flagged=True), 0.02
                ),
            }
        ),
    }
)
"""By autopilot and message id."""
