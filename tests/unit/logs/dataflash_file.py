"""DataFlash logs made from numbers: what a copter writes in flight, as large as one likes, and damage to them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

CODES: Mapping[str, str] = {
    "a": "(32,)<i2",
    "b": "i1",
    "B": "u1",
    "g": "<f2",
    "h": "<i2",
    "H": "<u2",
    "i": "<i4",
    "I": "<u4",
    "f": "<f4",
    "d": "<f8",
    "n": "S4",
    "N": "S16",
    "Z": "S64",
    "c": "<i2",
    "C": "<u2",
    "e": "<i4",
    "E": "<u4",
    "L": "<i4",
    "M": "u1",
    "q": "<i8",
    "Q": "<u8",
}
CYCLES = 40
"""Main loops of 2.5 ms in a block of 0.1 s, after which the slow messages come."""


@dataclass(frozen=True)
class Message:
    """A message type as FMT defines it."""

    type: int
    name: str
    letters: str
    columns: str

    @property
    def dtype(self) -> np.dtype[Any]:
        """The whole message with its header."""
        fields = zip(self.columns.split(","), self.letters, strict=True)
        return np.dtype([("_head", "u1", 3), *((name, CODES[letter]) for name, letter in fields if name)])

    def rows(self, count: int, **values: Any) -> np.ndarray[Any, Any]:
        """`count` messages with these columns, in the units of the wire; the others are 0."""
        rows = np.zeros(count, self.dtype)
        rows["_head"] = (0xA3, 0x95, self.type)
        for name, value in values.items():
            rows[name] = value
        return rows

    def definition(self) -> bytes:
        """Its FMT."""
        return FMT.rows(
            1,
            Type=self.type,
            Length=self.dtype.itemsize,
            Name=self.name.encode(),
            Format=self.letters.encode(),
            Columns=self.columns.encode(),
        ).tobytes()


FMT = Message(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
PARM = Message(64, "PARM", "QNff", "TimeUS,Name,Value,Default")
MSG = Message(65, "MSG", "QZ", "TimeUS,Message")
IMU = Message(66, "IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz")
RATE = Message(67, "RATE", "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut")
MAG = Message(68, "MAG", "QBhhhhhhhhhBI", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,MOX,MOY,MOZ,Health,S")
ATT = Message(69, "ATT", "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF")
BAT = Message(70, "BAT", "QBfffffcf", "TimeUS,Instance,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res")
GPS = Message(71, "GPS", "QBBIHBcLLeffffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw,U")
MESSAGES = (FMT, PARM, MSG, IMU, RATE, MAG, ATT, BAT, GPS)

PARAMETERS: Mapping[str, float] = {
    "AHRS_ORIENTATION": 0.0,
    **{f"INS_{part}_{axis}": 0.0 for part in ("ACCOFFS", "ACC2OFFS", "GYROFFS", "GYR2OFFS") for axis in "XYZ"},
    **{f"INS_{part}_{axis}": 1.0 for part in ("ACCSCAL", "ACC2SCAL") for axis in "XYZ"},
    **{f"COMPASS_{part}_{axis}": 0.0 for part in ("OFS", "ODI", "MOT") for axis in "XYZ"},
    **{f"COMPASS_DIA_{axis}": 1.0 for axis in "XYZ"},
    "COMPASS_EXTERNAL": 0.0,
    "COMPASS_ORIENT": 0.0,
    "COMPASS_MOTCT": 0.0,
}


def head(parameters: Mapping[str, float] = PARAMETERS, start_us: int = 5_000_000) -> bytes:
    """Definitions, what the vehicle says of itself, and its parameters."""
    parts = [message.definition() for message in MESSAGES]
    parts += [PARM.rows(1, TimeUS=start_us, Name=n.encode(), Value=v).tobytes() for n, v in parameters.items()]
    parts.append(MSG.rows(1, TimeUS=start_us, Message=b"ArduCopter V4.5.7 (2a3dc4b7)").tobytes())
    return b"".join(parts)


def blocks(count: int, seed: int, start_us: int = 5_000_000) -> Iterator[np.ndarray[Any, Any]]:
    """Pieces of `count` blocks of 0.1 s: two inertial units and RATE at 400 Hz, MAG, ATT, BAT and GPS at 10 Hz."""
    rng = np.random.default_rng(seed)
    layout = np.dtype(
        [("fast", np.dtype([("imu", IMU.dtype, 2), ("rate", RATE.dtype)]), CYCLES)]
        + [(m.name, m.dtype) for m in (MAG, ATT, BAT, GPS)]
    )
    for first in range(0, count, 1000):
        n = min(1000, count - first)
        piece = np.zeros(n, layout)
        t = start_us + 100_000 * (first + np.arange(n, dtype=np.uint64))
        fast_t = t[:, None] + (2500 * np.arange(CYCLES)).astype(np.uint64)
        imu, rate = piece["fast"]["imu"], piece["fast"]["rate"]
        imu["_head"], rate["_head"] = (0xA3, 0x95, IMU.type), (0xA3, 0x95, RATE.type)
        imu["TimeUS"], rate["TimeUS"] = fast_t[..., None], fast_t
        imu["I"] = [0, 1]
        for axis, level in zip("XYZ", (0.0, 0.0, -9.8), strict=True):
            imu[f"Gyr{axis}"] = rng.normal(0.0, 0.01, imu.shape)
            imu[f"Acc{axis}"] = rng.normal(level, 0.3, imu.shape)
        imu["T"], imu["GH"], imu["AH"], imu["GHz"], imu["AHz"] = 40.0, 1, 1, 1000, 1000
        for name in RATE.columns.split(",")[1:]:
            rate[name] = rng.normal(0.0, 1.0, rate.shape)
        _slow(piece, t, rng)
        yield piece


def _slow(piece: np.ndarray[Any, Any], t: np.ndarray[Any, Any], rng: np.random.Generator) -> None:
    yaw = 0.02 * np.arange(len(t))
    for message in (MAG, ATT, BAT, GPS):
        piece[message.name]["_head"] = (0xA3, 0x95, message.type)
        piece[message.name]["TimeUS"] = t + np.uint64(99_000)
    mag, att, gps = piece["MAG"], piece["ATT"], piece["GPS"]
    for axis, value in zip("XYZ", (220 * np.cos(yaw), -220 * np.sin(yaw), 0 * yaw + 400), strict=True):
        mag[f"Mag{axis}"] = value + rng.normal(0.0, 2.0, len(t))
    mag["Health"], mag["S"] = 1, (t + np.uint64(99_000)).astype(np.uint32)
    att["Yaw"] = (np.degrees(yaw) % 360 * 100).astype(np.uint16)
    piece["BAT"]["Curr"], piece["BAT"]["Volt"] = rng.normal(15.0, 2.0, len(t)), 15.0
    gps["Status"], gps["GWk"], gps["GMS"] = 3, 2300, (t // 1000).astype(np.uint32)
    gps["Lat"], gps["Lng"], gps["Alt"] = -353632610, 1491652300, 58400


def write_flight(path: Path, size: int, seed: int) -> None:
    """A flight of about `size` bytes."""
    block = CYCLES * (2 * IMU.dtype.itemsize + RATE.dtype.itemsize) + sum(
        m.dtype.itemsize for m in (MAG, ATT, BAT, GPS)
    )
    with path.open("wb") as file:
        file.write(head())
        for piece in blocks(max(1, size // block), seed):
            piece.tofile(file)


def flight(seconds: float, seed: int, start_us: int = 5_000_000) -> bytes:
    """The same as bytes, `seconds` long."""
    return head() + b"".join(piece.tobytes() for piece in blocks(max(1, round(10 * seconds)), seed, start_us))


def flipped(data: bytes, count: int, seed: int) -> tuple[bytes, np.ndarray[Any, Any]]:
    """`data` with `count` bytes changed, and where."""
    rng = np.random.default_rng(seed)
    out = np.frombuffer(data, np.uint8).copy()
    where = rng.integers(0, len(out), count)
    out[where] ^= rng.integers(1, 256, count).astype(np.uint8)
    return out.tobytes(), np.unique(where)


def cut(data: bytes, count: int, longest: int, seed: int) -> tuple[bytes, Sequence[tuple[int, int]]]:
    """`data` with `count` stretches of up to `longest` bytes taken out, and which."""
    rng = np.random.default_rng(seed)
    starts = np.sort(rng.choice(len(data) // (2 * longest), count, replace=False)) * 2 * longest
    stretches = [(int(start), int(start) + int(rng.integers(1, longest + 1))) for start in starts]
    parts, at = [], 0
    for start, end in stretches:
        parts.append(data[at:start])
        at = end
    return b"".join([*parts, data[at:]]), stretches
