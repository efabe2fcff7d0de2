"""``python -m tests.campaign.fuzz``: mutated files for every reader, in children limited as those of the service.

Every format starts from small sound files. A mutation is read, and what can be read is inspected; the answer has to be
a recording or the typed refusal. Whatever else an exception says is a defect; a child that dies, or needs more than the
limit of one file, is a death. Both are kept as files for a look, and the exit code is 1.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import random
import resource
import signal
import struct
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib import logs
from mavcal.calib.errors import CalibError
from mavcal.calib.logs.inspection import inspect
from mavcal.calib.methods.overview import overview
from mavcal.calib.report import to_json

CPU_S = 5.0
"""Most processor time for one file."""
MEMORY = 1 << 30
BATCH = 1000
OVERVIEW_EACH = 50
"""Every so many files that can be read pass the sanity of flights too, which takes longest."""
BYTES = (0, 1, 2, 3, 7, 8, 13, 15, 16, 32, 44, 45, 57, 64, 127, 128, 129, 254, 255)
WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
TOKENS = (
    b"nan",
    b"1e999",
    b"-1",
    b"9" * 400,
    b"",
    b",,,",
    b"\0",
    b"\xff\xfe",
    b"FMT,",
    b"inf",
    b"#",
    b"\n\n",
    b"\r",
    b'"',
)

Mutate = Callable[[random.Random], bytes]


@dataclass
class Row:
    """What became of the files of one format."""

    runs: int = 0
    read: int = 0
    refused: int = 0
    memory: int = 0
    defects: int = 0
    deaths: int = 0
    longest_s: float = 0.0
    peak_mib: int = 0
    seen: dict[str, str] = field(default_factory=dict)
    """One file for each kind of defect and death."""


def mutated(data: bytes, rng: random.Random) -> bytes:
    """`data` with one to six changes."""
    made = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        if not made:
            return bytes(made)
        at = rng.randrange(len(made)) if rng.random() < 0.7 else rng.randrange(min(len(made), 400))
        what = rng.randrange(9)
        size = rng.choice((1, 2, 4, 8, 40, 400))
        if what == 0:
            made[at] ^= 1 << rng.randrange(8)
        elif what == 1:
            made[at] = rng.choice(BYTES)
        elif what in (2, 3):
            form = rng.choice(("<H", "<I", ">I", "<Q"))
            word = struct.pack(form, rng.choice(WORDS) & (2 ** (8 * struct.calcsize(form)) - 1))
            made[at : at + len(word)] = word
        elif what == 4:
            del made[at : at + size]
        elif what == 5:
            made[at:at] = made[at : at + size]
        elif what == 6:
            made[at : at + size] = rng.randbytes(size)
        elif what == 7:
            made[at : at + rng.randrange(8)] = rng.choice(TOKENS)
        else:
            del made[at if rng.random() < 0.3 else len(made) - min(len(made), size) :]
    return bytes(made)


def _to_json(*seeds: bytes) -> Mutate:
    return lambda rng: mutated(rng.choice(seeds), rng)


def dataflash() -> Mutate:
    """A copter's log, short."""
    from tests.unit.logs.dataflash_file import flight

    return _to_json(flight(0.1, 1)[:6000], flight(0.1, 2)[:9000])


def dataflash_text() -> Mutate:
    """The lines of an old firmware."""
    head = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 129, 31, PARM, QNf, TimeUS,Name,Value",
        "FMT, 130, 35, IMU, Iffffff, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 131, 20, MAG, Ihhh, TimeMS,MagX,MagY,MagZ",
        "FMT, 132, 60, MSG, QZ, TimeUS,Message",
        "PARM, 1000, INS_ACCOFFS_X, 0.1",
        "MSG, 1000, ArduCopter V3.2",
    ]
    rows = [f"IMU, {20 * k}, 0.01, -0.0{k % 9}, 0.0, 0.1, 0.{k % 7}, -9.8" for k in range(24)]
    rows += [f"MAG, {20 * k}, {100 + k % 3}, {-50 - k % 5}, 400" for k in range(24)]
    return _to_json("\n".join(head + rows).encode())


def ulog() -> Mutate:
    """A PX4 log with three drivers, a nested format and parameters."""
    from tests.unit.logs.ulog_file import ACCEL_ID, GYRO_ID, MAG_ID, UlogFile, driver, sample

    log = UlogFile()
    log.format("inner", "float[3] x;uint8_t y;")
    topics = [driver(log, f"sensor_{n}", i) for n, i in (("accel", ACCEL_ID), ("gyro", GYRO_ID), ("mag", MAG_ID))]
    log.said(1_000_100, "armed")
    log.dropout(20)
    for k in range(20):
        for topic in topics:
            sample(log, topic, 1_000_000 + 20_000 * k, 0.1, 0.01 * (k % 5), -9.8)
    sync = struct.pack("<HB", 8, ord("S")) + bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
    return _to_json(log.bytes, log.bytes[:-300] + sync + log.bytes[-300:])


def tlog() -> Mutate:
    """A telemetry log; half of the changes lie within payloads whose checksum is right again."""
    from pymavlink.dialects.v20 import ardupilotmega as dialect
    from pymavlink.generator.mavcrc import x25crc

    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    records = []
    for k in range(20):
        said: list[Any] = [mav.raw_imu_encode(1_000_000 + 20_000 * k, 0, 0, -1000, 1, 2, 3, 200, 0, 400)]
        if k % 10 == 0:
            said += [mav.heartbeat_encode(2, 3, 0, 0, 3), mav.param_value_encode(b"INS_ACCOFFS_X", 0.1, 9, 3, k)]
            said += [mav.statustext_encode(6, b"ready"), mav.attitude_encode(20 * k, 0, 0, 0, 0, 0, 0)]
        for message in said:
            records.append(struct.pack(">Q", 1_700_000_000_000_000 + 20_000 * k) + message.pack(mav))
            mav.seq = (mav.seq + 1) % 256
    whole = b"".join(records)

    def payloads(rng: random.Random) -> bytes:
        made = list(records)
        for _ in range(rng.randint(1, 8)):
            k = rng.randrange(len(made))
            frame = bytearray(made[k][8:])
            frame[10:-2] = mutated(bytes(frame[10:-2]), rng)[:255]
            frame[1] = len(frame) - 12
            if rng.random() < 0.2:
                frame[5] = rng.randrange(256)
            extra = dialect.mavlink_map[int.from_bytes(frame[7:10], "little")].crc_extra
            crc = x25crc(bytes(frame[1:-2]))
            crc.accumulate(bytes([extra]))
            frame[-2:] = struct.pack("<H", crc.crc)
            made[k] = made[k][:8] + bytes(frame)
        return b"".join(made)

    return lambda rng: payloads(rng) if rng.random() < 0.5 else mutated(whole, rng)


def csv() -> Mutate:
    """A table as text, in two dialects."""
    rows = [f"{k / 50},{k % 3},0.{k % 7},-9.8,{20 + k}.5,1,face{k // 10}" for k in range(30)]
    one = "t,accel_x,accel_y,accel_z,current,temperature,segment\n" + "\n".join(rows)
    return _to_json(one.encode(), ("# made\n" + one.replace(",", ";").replace(".", ",")).encode())


def _arrays() -> dict[str, Any]:
    rng = np.random.default_rng(1)
    return {"t": np.arange(30.0), "accel": rng.normal(size=(30, 3)), "mag": np.ones((30, 3), np.float32),
            "temperature": np.arange(30, dtype=np.int16), "segment": np.array(["a"] * 15 + ["bc"] * 15)}  # fmt: skip


def npz() -> Mutate:
    """An archive of arrays; half of the changes lie within members whose checksum is right again."""
    whole, packed = io.BytesIO(), io.BytesIO()
    np.savez(whole, **_arrays())
    np.savez_compressed(packed, **_arrays())
    with zipfile.ZipFile(whole) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}

    def inside(rng: random.Random) -> bytes:
        chosen, made = rng.choice(list(members)), io.BytesIO()
        with zipfile.ZipFile(made, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for name, content in members.items():
                archive.writestr(name, mutated(content[:140], rng) + content[140:] if name == chosen else content)
        return made.getvalue()

    seeds = whole.getvalue(), packed.getvalue()
    return lambda rng: inside(rng) if rng.random() < 0.5 else mutated(rng.choice(seeds), rng)


def mat() -> Mutate:
    """A MATLAB file; some changes lie within elements that are compressed afterwards."""
    import scipy.io

    plain, packed = io.BytesIO(), io.BytesIO()
    scipy.io.savemat(plain, {**_arrays(), "cells": np.array([1, "a"], dtype=object), "s": {"a": 1.0}})
    scipy.io.savemat(packed, _arrays(), do_compression=True)
    seeds = plain.getvalue(), packed.getvalue()

    def inside(rng: random.Random) -> bytes:
        content = zlib.compress(mutated(seeds[0][128:1200], rng))
        return seeds[0][:128] + struct.pack("<II", 15, len(content)) + content

    return lambda rng: inside(rng) if rng.random() < 0.3 else mutated(rng.choice(seeds), rng)


FORMATS: dict[str, tuple[str, Callable[[], Mutate]]] = {
    "DataFlash": (".bin", dataflash),
    "DataFlash text": (".log", dataflash_text),
    "ULog": (".ulg", ulog),
    "tlog": (".tlog", tlog),
    "CSV": (".csv", csv),
    "NPZ": (".npz", npz),
    "MAT": (".mat", mat),
}


def campaign(name: str, runs: int, seed: int, folder: Path, batch: int = BATCH) -> Row:
    """`runs` mutations of one format; children work off batches, and a new one follows one that dies."""
    ending, prepare = FORMATS[name]
    mutate = prepare()
    row, at = Row(runs=runs), 0
    while at < runs:
        until = min(at + batch, runs)
        reading, writing = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(reading)
            _child(mutate, f"{name}/{seed}", range(at, until), folder / f"file{ending}", writing)
        os.close(writing)
        with os.fdopen(reading, "r") as told:
            lines = [json.loads(line) for line in told]
        _, status, used = os.wait4(pid, 0)
        row.peak_mib = max(row.peak_mib, used.ru_maxrss >> 10)
        for line in lines:
            _count(row, line, mutate, f"{name}/{seed}", folder, ending)
        at += len(lines)
        if at < until:  # it died of this one
            row.deaths += 1
            _keep(row, f"death-{status}", mutate(_rng(f"{name}/{seed}", at)), folder, ending)
            at += 1
    return row


def _rng(seed: str, number: int) -> random.Random:
    return random.Random(f"{seed}/{number}")


def _count(row: Row, line: dict[str, Any], mutate: Mutate, seed: str, folder: Path, ending: str) -> None:
    row.longest_s = max(row.longest_s, line["s"])
    what = line["what"]
    if what in ("read", "refused", "memory"):
        setattr(row, what, getattr(row, what) + 1)
    else:
        row.defects += 1
        _keep(row, what, mutate(_rng(seed, line["number"])), folder, ending)


def _keep(row: Row, what: str, data: bytes, folder: Path, ending: str) -> None:
    if what not in row.seen:
        path = folder / f"kept-{len(list(folder.glob('kept-*')))}{ending}"
        path.write_bytes(data)
        row.seen[what] = str(path)


def _child(mutate: Mutate, seed: str, numbers: range, path: Path, told: int) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        for number in numbers:
            path.write_bytes(mutate(_rng(seed, number)))
            began = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, CPU_S)  # its signal ends the process, wherever it is
            try:
                recording = logs.read(path)
                json.dumps(to_json((overview if number % OVERVIEW_EACH == 0 else inspect)(recording)), allow_nan=False)
                what = "read"
            except CalibError as error:
                what = "refused" if len(str(error)) < 2000 else "a refusal longer than 2000 characters"
            except MemoryError:
                what = "memory"
            except Exception as error:  # noqa: BLE001 - what it is, is the question
                frame = error.__traceback__
                while frame is not None and frame.tb_next is not None:
                    frame = frame.tb_next
                where = "" if frame is None else f" at {Path(frame.tb_frame.f_code.co_filename).name}:{frame.tb_lineno}"
                what = f"{type(error).__name__}{where}: {error}"[:200]
            signal.setitimer(signal.ITIMER_PROF, 0)
            line = {"number": number, "what": what, "s": time.process_time() - began}
            os.write(told, json.dumps(line).encode() + b"\n")
    finally:
        os._exit(0)


def table(rows: dict[str, Row]) -> Iterator[str]:
    """The rows as Markdown."""
    yield "| reader | runs | read | refused | over 1 GiB | defects | deaths | longest, s | peak, MiB |"
    yield "|---|---|---|---|---|---|---|---|---|"
    for name, r in rows.items():
        yield (
            f"| {name} | {r.runs} | {r.read} | {r.refused} | {r.memory} | {r.defects} | {r.deaths} "
            f"| {r.longest_s:.2f} | {r.peak_mib} |"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=20_000, help="mutations of each format")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--format", action="append", choices=list(FORMATS))
    chosen = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="mavcal-fuzz-"))
    rows: dict[str, Row] = {}
    print(f"seed {chosen.seed}, {chosen.runs} mutations of each format")
    for name in chosen.format or FORMATS:
        began = time.monotonic()
        rows[name] = campaign(name, chosen.runs, chosen.seed, folder)
        print(f"{name}: {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)
        for what, path in rows[name].seen.items():
            print(f"{name}: {what} -> {path}", file=sys.stderr, flush=True)
    print(*table(rows), sep="\n")
    return int(any(r.deaths or r.defects for r in rows.values()))


if __name__ == "__main__":
    sys.exit(main())
