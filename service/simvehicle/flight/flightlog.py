"""The messages of the log: names, letters, columns and numbers as ArduCopter 4.7 writes them (``LogStructure.h``)."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from mavcal.service.simvehicle.flight.airframe import in_body
from mavcal.service.simvehicle.flight.items import Item
from mavcal.service.simvehicle.flight.parameters import DEFAULTS
from mavcal.service.simvehicle.flight.vehicle import FlyingVehicle

# DataFlash: definitions (FMT) first, then two magic bytes, a type and the packed values (``LogStructure.h``).
_MAGIC = b"\xa3\x95"
_FMT = 128
_LETTERS: Mapping[str, str] = {
    "b": "b", "B": "B", "h": "h", "H": "H", "i": "i", "I": "I", "f": "f", "d": "d", "n": "4s", "N": "16s", "Z": "64s",
    "c": "h", "C": "H", "e": "i", "E": "I", "L": "i", "M": "B", "q": "q", "Q": "Q",
}  # fmt: skip
_SCALED: Mapping[str, float] = {"c": 100.0, "C": 100.0, "e": 100.0, "E": 100.0, "L": 1e7}
"""Format letters of scaled integers: hundredths (of degrees, metres ...) and ten-millionths."""
_TEXTS = "nNZ"


class Message:
    """One kind of message: its number, name, letters and columns."""

    def __init__(self, number: int, name: str, letters: str, columns: str) -> None:
        self.number, self.name, self.letters, self.columns = number, name, letters, columns
        self._packer = struct.Struct("<" + "".join(_LETTERS[letter] for letter in letters))
        self._head = _MAGIC + bytes([number])
        self._scaled = tuple((k, _SCALED[letter]) for k, letter in enumerate(letters) if letter in _SCALED)
        self._texts = tuple(k for k, letter in enumerate(letters) if letter in _TEXTS)

    def packed(self, *values: Any) -> bytes:
        """The bytes of one message; scaled letters take the value itself."""
        if self._scaled or self._texts:
            row = list(values)
            for k, factor in self._scaled:
                row[k] = round(row[k] * factor)
            for k in self._texts:
                row[k] = row[k].encode("ascii", "replace")
            values = tuple(row)
        return self._head + self._packer.pack(*values)

    @property
    def definition(self) -> tuple[int, int, str, str, str]:
        """The values of its FMT message."""
        return self.number, 3 + self._packer.size, self.name, self.letters, self.columns


FMT = Message(_FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")


class DataFlashWriter:
    """A file that begins with the definitions of `messages`."""

    def __init__(self, path: Path, messages: tuple[Message, ...]) -> None:
        self._file: BinaryIO = path.open("wb")
        for message in (FMT, *messages):
            self._file.write(FMT.packed(*message.definition))

    def write(self, message: Message, *values: Any) -> None:
        """One message."""
        self._file.write(message.packed(*values))

    def flush(self) -> None:
        """Write buffered messages to the file."""
        self._file.flush()

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        self._file.close()


IMU = Message(163, "IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz")
RATE = Message(75, "RATE", "Qfffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut,AOutSlew")
RCOU = Message(62, "RCOU", "Q" + "H" * 14, "TimeUS," + ",".join(f"C{k}" for k in range(1, 15)))
MOTB = Message(205, "MOTB", "QfffffB", "TimeUS,LiftMax,BatVolt,ThLimit,ThrAvMx,ThrOut,FailFlags")
CTUN = Message(0, "CTUN", "Qffffffefffhh", "TimeUS,ThI,ABst,ThO,ThH,DAlt,Alt,BAlt,DSAlt,SAlt,TAlt,DCRt,CRt")
BAT = Message(88, "BAT", "QBfffffcfBBB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct,H,SH")
ATT = Message(72, "ATT", "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF")
BARO = Message(64, "BARO", "QBfffcfIffBf", "TimeUS,I,Alt,AltAMSL,Press,Temp,CRt,SMS,Offset,GndTemp,H,CPress")
MAG = Message(111, "MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
RFND = Message(203, "RFND", "QBCBB", "TimeUS,Instance,Dist,Stat,Orient")
XKF1 = Message(44, "XKF1", "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH")
XKF2 = Message(45, "XKF2", "QBccccchhhhhhfff", "TimeUS,C,AX,AY,AZ,VWN,VWE,MN,ME,MD,MX,MY,MZ,IDX,IDY,IS")
XKQ = Message(52, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4")
GPS = Message(94, "GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U")
GPA = Message(95, "GPA", "QBCCCCfBIHeHH", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,AEl,RTCMFU,RTCMFD")
PARM = Message(32, "PARM", "QNff", "TimeUS,Name,Value,Default")
MSG = Message(59, "MSG", "QZ", "TimeUS,Message")
MODE = Message(120, "MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
ARM = Message(186, "ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method")
EV = Message(181, "EV", "QB", "TimeUS,Id")
CMD = Message(143, "CMD", "QHHHffffLLfB", "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame")
MESSAGES = (
    IMU, RATE, RCOU, MOTB, CTUN, BAT, ATT, BARO, RFND, MAG, XKF1, XKF2, XKQ, GPS, GPA, PARM, MSG, MODE, ARM, EV, CMD,
)  # fmt: skip

SECOND_IMU, ESTIMATOR, HOUSEKEEPING, POSITIONING = 10, 16, 40, 80
"""Number of loops between two messages: 40, 25, 10 and 5 Hz."""
FIELD_MGAUSS = (230.0, 55.0, -525.0)
"""North east down, near SITL's usual home."""
GPS_WEEK, GPS_START_MS = 2446, 96_000_000
_BOARD_C = 35.0
_RANGED_M, _BELLY_M, _GOOD, _DOWN = 40.0, 0.05, 4, 25
"""Range of the rangefinder, its height when the vehicle stands, RangeFinder::Status::Good, ROTATION_PITCH_270."""
_AVERAGE_MOST = 0.1
"""MOTB.ThrAvMx by the hover throttle while idle (ATC_THR_MIX_MIN)."""


class FlightLog:
    """Writes the messages due after each loop."""

    def __init__(self, path: Path) -> None:
        self._out = DataFlashWriter(path, MESSAGES)
        self._loop = 0

    def begin(self, vehicle: FlyingVehicle) -> None:
        """Log the parameters and the firmware's version."""
        us = vehicle.time_us
        for name in vehicle.parameters:
            value = vehicle.parameters[name]
            self._out.write(PARM, us, name, value, DEFAULTS.get(name, math.nan))
        kind = "PLUS" if vehicle.parameters["FRAME_TYPE"] == 0 else "X"
        for text in ("ArduCopter V4.7.0 (mavcal simulate flight)", f"Frame: QUAD/{kind}"):
            self.text(us, text)
        self.mode(us, vehicle.mode, 1)

    def text(self, us: int, text: str) -> None:
        """Log a message in words."""
        self._out.write(MSG, us, text)

    def mode(self, us: int, number: int, reason: int) -> None:
        """Log a change of the flight mode."""
        self._out.write(MODE, us, number, number, reason)

    def mission(self, us: int, items: Sequence[Item]) -> None:
        """Log an uploaded mission."""
        self.text(us, "New mission")
        for number, item in enumerate(items):
            place = (item.latitude, item.longitude, item.altitude, item.frame)
            self._out.write(CMD, us, len(items), number, item.command, *item.parameters, *place)

    def parameter(self, us: int, name: str, value: float) -> None:
        """Log a parameter that was set."""
        self._out.write(PARM, us, name, value, math.nan)

    def armed(self, us: int, *, armed: bool) -> None:
        """Log that the motors were armed or disarmed."""
        self._out.write(ARM, us, int(armed), int(armed), 0, 1)
        self._out.write(EV, us, 10 if armed else 11)
        if not armed:
            self._out.flush()

    def loop(self, vehicle: FlyingVehicle) -> None:
        """Log the messages due after a main loop."""
        us, k = vehicle.time_us, self._loop
        self._loop += 1
        self._rate(us, vehicle)
        self._imu(us, vehicle, 0)
        if k % SECOND_IMU == 0:
            self._imu(us, vehicle, 1)
        if k % ESTIMATOR == 0:
            self._estimate(us, vehicle)
        if k % HOUSEKEEPING == 0:
            self._housekeeping(us, vehicle)
        if k % POSITIONING == 0:
            self._positioning(us, vehicle)

    def close(self) -> None:
        """Close the log."""
        self._out.close()

    def _rate(self, us: int, vehicle: FlyingVehicle) -> None:
        control, degrees = vehicle.control, math.degrees
        (p, q, r), (roll, pitch, yaw) = vehicle.units[0].gyro, control.outputs
        wp, wq, wr = control.wanted_rate
        up = -100.0 * (vehicle.units[0].accel[2] + 9.80665)
        self._out.write(
            RATE, us, degrees(wp), degrees(p), roll, degrees(wq), degrees(q), pitch, degrees(wr), degrees(r), yaw,
            100.0 * control.acceleration_target, up, control.throttle, 0.0,
        )  # fmt: skip

    def _imu(self, us: int, vehicle: FlyingVehicle, k: int) -> None:
        unit = vehicle.units[k]
        self._out.write(IMU, us, k, *unit.gyro, *unit.accel, 0, 0, _BOARD_C, 1, 1, 800, 800)

    def _estimate(self, us: int, vehicle: FlyingVehicle) -> None:
        roll, pitch, yaw = (math.degrees(angle) for angle in vehicle.estimate.euler)
        v, p = vehicle.estimate.velocity, vehicle.estimate.place
        self._out.write(
            XKF1, us, 0, roll, pitch, yaw % 360.0, *v, v[2], *p, 0.0, 0.0, 0.0, vehicle.altitude_home
        )  # fmt: skip
        self._out.write(XKF2, us, 0, 0, 0, 0, 0, 0, *map(int, FIELD_MGAUSS), 0, 0, 0, 0.0, 0.0, 0.0)
        self._out.write(XKQ, us, 0, *vehicle.estimate.q)

    def _housekeeping(self, us: int, vehicle: FlyingVehicle) -> None:
        control, mixer, battery, parameters = vehicle.control, vehicle.mixer, vehicle.battery, vehicle.parameters
        height, up = -vehicle.estimate.place[2], -vehicle.estimate.velocity[2]
        average = 1.0 if vehicle.flying else _AVERAGE_MOST * control.hover
        self._out.write(RCOU, us, *vehicle.pulses, *[0] * 10)
        self._out.write(MOTB, us, mixer.lift_max, mixer.ratio, 1.0, average, control.throttle, 0)
        self._out.write(
            CTUN, us, control.throttle, 0.0, control.throttle, control.hover, height, height, height, math.nan, 0.0,
            0.0, round(100.0 * control.climb_target), round(100.0 * up),
        )  # fmt: skip
        left = 100.0
        if vehicle.frame.battery_capacity > 0.0:
            left = max(100.0 - 0.1 * battery.used_mah / vehicle.frame.battery_capacity, 0.0)
        self._out.write(
            BAT, us, 0, battery.voltage, battery.voltage + vehicle.frame.battery_resistance * battery.current,
            battery.current, battery.used_mah, 0.0, 0.0, vehicle.frame.battery_resistance, int(left), 1, 0,
        )  # fmt: skip
        wanted = [math.degrees(angle) for angle in control.attitude]
        is_ = [math.degrees(angle) for angle in vehicle.estimate.euler]
        self._out.write(ATT, us, wanted[0], is_[0], wanted[1], is_[1], wanted[2] % 360.0, is_[2] % 360.0, 3)
        press, ground_c = vehicle.pressure(), vehicle.ground_temperature
        self._out.write(
            BARO, us, 0, height, vehicle.altitude_home + height, press, ground_c, up, us // 1000, 0.0, ground_c, 1,
            press,
        )  # fmt: skip
        if parameters["RNGFND1_TYPE"]:
            self._out.write(RFND, us, 0, min(_BELLY_M - vehicle.airframe.place[2], _RANGED_M), _GOOD, _DOWN)
        field = [int(one) for one in in_body(vehicle.airframe.q, FIELD_MGAUSS)]
        self._out.write(MAG, us, 0, *field, *[int(o) for o in parameters.vector("COMPASS_OFS")], 0, 0, 0, 1, us)

    def _positioning(self, us: int, vehicle: FlyingVehicle) -> None:
        down = vehicle.airframe.place[2]
        vn, ve, vd = vehicle.airframe.velocity
        latitude, longitude = vehicle.position()
        speed, course = math.hypot(vn, ve), math.degrees(math.atan2(ve, vn)) % 360.0
        ms, alt = us // 1000, vehicle.altitude_home - down
        fix = 6 if vehicle.parameters["SIM_GPS1_ENABLE"] else 0
        self._out.write(
            GPS, us, 0, fix, GPS_START_MS + ms, GPS_WEEK, 10, 1.21, latitude, longitude, alt, speed, course, vd, 0.0, 1
        )
        self._out.write(GPA, us, 0, 2.0, 0.3, 0.3, 0.05, 0.0, 1, ms, 200, alt, 0, 0)
