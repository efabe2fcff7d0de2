"""A small ULog written byte by byte, after the format's description (docs.px4.io, "ULog file format")."""

from __future__ import annotations

import struct

MAGIC = b"ULog\x01\x12\x35\x01"
ACCEL_ID, GYRO_ID, MAG_ID = 3932170, 3932171, 396825
TYPES = {"uint64_t": "Q", "uint32_t": "I", "int32_t": "i", "uint16_t": "H", "uint8_t": "B", "float": "f", "double": "d"}

PARAMETERS: dict[str, float | int] = (
    {"SENS_BOARD_ROT": 0, "SENS_BOARD_X_OFF": 0.0, "SENS_BOARD_Y_OFF": 0.0, "SENS_BOARD_Z_OFF": 0.0}
    | {f"CAL_{s}0_{r}": v for s in ("ACC", "GYRO", "MAG") for r, v in (("PRIO", 50), ("ROT", -1))}
    | {"CAL_ACC0_ID": ACCEL_ID, "CAL_GYRO0_ID": GYRO_ID, "CAL_MAG0_ID": MAG_ID}
    | {f"CAL_{s}0_{a}OFF": 0.0 for s in ("ACC", "GYRO", "MAG") for a in "XYZ"}
    | {f"CAL_{s}0_{a}SCALE": 1.0 for s in ("ACC", "MAG") for a in "XYZ"}
    | {f"CAL_MAG0_{a}ODIAG": 0.0 for a in "XYZ"}
    | {f"CAL_{s}{n}_ID": 0 for s in ("ACC", "GYRO", "MAG") for n in (1, 2, 3)}
    | {"CAL_MAG_COMP_TYP": 0}
)


def message(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def keyed(type_and_name: str, value: bytes) -> bytes:
    return struct.pack("<B", len(type_and_name)) + type_and_name.encode() + value


def parameter(name: str, value: float | int) -> bytes:
    kind, code = ("int32_t", "<i") if isinstance(value, int) else ("float", "<f")
    return message("P", keyed(f"{kind} {name}", struct.pack(code, value)))


class UlogFile:
    """Collects definitions and data; `bytes` is the file."""

    def __init__(self, parameters: dict[str, float | int] | None = None, start_us: int = 1_000_000) -> None:
        self._head = MAGIC + struct.pack("<Q", start_us) + message("B", bytes(40))
        uuid = b"000200000000353338373138511600380018"
        self._head += message("I", keyed(f"char[{len(uuid)}] sys_uuid", uuid))
        self._head += message("I", keyed("uint32_t ver_sw_release", struct.pack("<I", 0x010E03FF)))
        for name, value in (PARAMETERS if parameters is None else parameters).items():
            self._head += parameter(name, value)
        self._formats = b""
        self._subscriptions = b""
        self._data: list[bytes] = []
        self._layouts: list[str] = []
        self.devices: dict[int, int] = {}

    def topic(self, name: str, fields: str, multi_id: int = 0, layout: str = "") -> int:
        """Define and subscribe to a topic whose `fields` are ``type name;...`` after the time stamp.

        `layout` is that of ``struct`` where formats lie in the format.
        """
        text = f"uint64_t timestamp;{fields}"
        self._formats += message("F", f"{name}:{text}".encode())
        number = len(self._layouts)
        self._subscriptions += message("A", struct.pack("<BH", multi_id, number) + name.encode())
        self._layouts.append(layout or "<" + "".join(_codes(field) for field in text.strip(";").split(";")))
        return number

    def format(self, name: str, fields: str) -> None:
        """Define a format that lies in others."""
        self._formats += message("F", f"{name}:{fields}".encode())

    def row(self, topic: int, *values: float | int) -> None:
        self._data.append(message("D", struct.pack("<H", topic) + struct.pack(self._layouts[topic], *values)))

    def changed(self, name: str, value: float | int) -> None:
        self._data.append(parameter(name, value))

    def dropout(self, milliseconds: int) -> None:
        self._data.append(message("O", struct.pack("<H", milliseconds)))

    def said(self, t_us: int, text: str) -> None:
        self._data.append(message("L", b"6" + struct.pack("<Q", t_us) + text.encode()))

    @property
    def bytes(self) -> bytes:
        return self._head + self._formats + self._subscriptions + b"".join(self._data)


def _codes(field: str) -> str:
    kind = field.split(" ")[0]
    base, _, size = kind.partition("[")
    return TYPES[base] * (int(size.rstrip("]")) if size else 1)


def driver(log: UlogFile, name: str, device: int, multi_id: int = 0) -> int:
    fields = "uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;float temperature"
    number = log.topic(name, fields, multi_id)
    log.devices[number] = device
    return number


def sample(log: UlogFile, topic: int, t_us: int, x: float, y: float, z: float, temperature: float = 25.0) -> None:
    log.row(topic, t_us, t_us, log.devices[topic], x, y, z, temperature)
