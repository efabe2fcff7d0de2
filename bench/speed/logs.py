"""DataFlash logs: speed and memory of the reader beside pymavlink's and the bare file, and what it saves of damage."""

from __future__ import annotations

import functools
import tracemalloc
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from pymavlink import DFReader

from bench.rows import Row, Section, beside, best_of
from mavcal.calib.logs import read
from mavcal.calib.logs.dataflash import DataFlash, TextLog
from mavcal.calib.recording import Recording
from tests.unit.logs import dataflash_file as made

SIZE = 250_000_000
DAMAGED_S = 500.0
SEED = 20261121
FIELDS = ("TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ")
SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"


def run(size: int = SIZE) -> Section:
    """Measure on a generated log, on every DataFlash log of ../shared/data, and under damage."""
    with TemporaryDirectory(prefix="mavcal-bench-") as folder:
        path = Path(folder) / "flight.bin"
        made.write_flight(path, size, SEED)
        rows = _generated(path)
    found = sorted(p for p in SHARED.rglob("*") if p.suffix.lower() == ".bin" or p.parent.name.startswith("df_loga"))
    rows += [_real(path) for path in found if path.is_file()]
    rows += _damaged(made.flight(DAMAGED_S, SEED))
    notes = (
        f"The log is generated (seed {SEED}): two inertial units and RATE at 400 Hz, the rest at 10 Hz. Field access "
        f"is {len(FIELDS)} fields of every IMU message, opening included: columns of `DataFlash` beside pymavlink's "
        "`recv_match` and as many attributes.",
        "Damage: the share of untouched rows of IMU that come back bit by bit. A row is touched if one of its bytes "
        "was flipped, deleted or overwritten. DataFlash has no checksum: a byte that changes inside a number goes "
        "unseen. Exceptions are a number that no sensor reads, and a time that its neighbours contradict.",
    )
    return Section("Reading DataFlash logs", tuple(rows), notes)


def _ours(path: Path) -> list[np.ndarray[Any, Any]]:
    return DataFlash(path)["IMU"].columns(*FIELDS)


def _theirs(path: Path, name: str = "IMU", fields: Sequence[str] = FIELDS, *, text: bool = False) -> None:
    reader = (DFReader.DFReader_text if text else DFReader.DFReader_binary)(str(path))
    while (message := reader.recv_match(type=name)) is not None:
        for field in fields:
            getattr(message, field, None)
    reader.close()


def _generated(path: Path) -> list[Row]:
    size = path.stat().st_size
    ours, whole = (best_of(5, lambda a=a: a(path)) for a in (_ours, read))
    return [
        Row(f"{size / 1e6:.0f} MB: field access", ">= 0.5 GB/s", _rate(size, ours), size / ours >= 0.5e9),
        beside("- pymavlink's recv_match", lambda: _ours(path), lambda: _theirs(path), 100.0),
        Row("- the whole recording", ">= 0.5 GB/s", _rate(size, whole), size / whole >= 0.5e9),
        _memory("- memory of the field access", *_peak(lambda: _ours(path))),
        _memory("- memory of the whole recording", *_peak(lambda: read(path))),
    ]


def _rate(size: int, seconds: float) -> str:
    return f"{size / seconds / 1e9:.3g} GB/s ({seconds:.3g} s)"


def _memory(what: str, peak: int, returned: int) -> Row:
    text = f"peak {peak / 1e6:.0f} MB for {returned / 1e6:.0f} MB returned: {peak / returned:.2f} x"
    return Row(what, "< 2 x what is returned", text, peak < 2 * returned)


def _peak(action: Callable[[], Any]) -> tuple[int, int]:
    """Most bytes allocated at once, and bytes of the arrays that are returned."""
    tracemalloc.start()
    result = action()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    channels = result.channels if isinstance(result, Recording) else ()
    arrays = [a for c in channels for a in (c.t, c.values, c.zero_bin) if a is not None] or result
    return peak, sum({id(array): array.nbytes for array in arrays}.values())


def _real(path: Path) -> Row:
    """Field access of the densest inertial message of a real log."""
    text = path.suffix == ".log"
    log = TextLog(path.read_bytes(), path.name) if text else DataFlash(path)
    name = max(log, key=lambda n: (n == "IMU", len(log[n])))
    fields = log[name].names[:7]

    def ours() -> None:
        opened = TextLog(path.read_bytes(), path.name, [name]) if text else DataFlash(path, [name])
        opened[name].columns(*fields)

    peer = functools.partial(_theirs, path, name, fields, text=text)
    return beside(f"{path.parent.name}/{path.name}: {len(log[name])} rows of {name}", ours, peer)


def _damaged(data: bytes) -> list[Row]:
    offsets = DataFlash(data)["IMU"].offsets
    rows = _imu(data)
    length = made.IMU.dtype.itemsize
    middle = int(offsets[len(offsets) // 2])
    flips, at = made.flipped(data, 2000, SEED)
    both, cuts = made.cut(flips, 50, 2000, SEED)
    retyped = bytearray(data)
    retyped[middle + 2] = 250
    as_fmt = bytearray(data)
    as_fmt[middle + 2] = 128
    cases: list[tuple[str, bytes, list[tuple[int, int]]]] = [
        ("none", data, []),
        ("100 bytes deleted", data[:middle] + data[middle + 100 :], [(middle, middle + 100)]),
        ("one type becomes unknown", bytes(retyped), [(middle, middle + 3)]),
        ("one type becomes FMT", bytes(as_fmt), [(middle, middle + 3)]),
        ("64 KiB zeroed", data[:middle] + bytes(65536) + data[middle + 65536 :], [(middle, middle + 65536)]),
        ("cut in the middle of a message", data[: middle + 20], [(middle + 20, len(data))]),
        ("2000 flipped bytes", flips, [(int(k), int(k) + 1) for k in at]),
        ("2000 flipped bytes and 50 cuts", both, [(int(k), int(k) + 1) for k in at] + list(cuts)),
    ]
    found = []
    for what, bad, touched in cases:
        hit = np.zeros(len(data) + 1, dtype=np.int64)
        for start, end in touched:
            hit[start:end] = 1
        total = np.concatenate([[0], np.cumsum(hit)])
        undamaged = rows[total[offsets + length] == total[offsets]]
        share = np.isin(undamaged, _imu(bad)).mean()
        text = f"{100 * share:.4f} % of {len(undamaged)} rows; pymavlink {_counted(bad, undamaged)}"
        found.append(Row(f"damage: {what}", ">= 99.9 %", text, bool(share >= 0.999)))
    return found


def _imu(data: bytes) -> np.ndarray[Any, Any]:
    """Every IMU message as one number that tells it from the others."""
    table = DataFlash(data)["IMU"]
    columns = table.columns("TimeUS", "I", "AccX", "GyrZ")
    bits = [column.view(f"u{column.dtype.itemsize}").astype(np.uint64) for column in columns]
    return bits[0] * np.uint64(8) + bits[1] + (bits[2] << np.uint64(34)) + (bits[3] << np.uint64(40))


def _counted(data: bytes, undamaged: np.ndarray[Any, Any]) -> str:
    """Rows that pymavlink's reader gives, or what it raises."""
    with TemporaryDirectory(prefix="mavcal-bench-") as folder:
        path = Path(folder) / "damaged.bin"
        path.write_bytes(data)
        try:
            with redirect_stderr(StringIO()), redirect_stdout(StringIO()):
                reader = DFReader.DFReader_binary(str(path))
            count = sum(len(reader.offsets[k]) for k, f in reader.formats.items() if f.name == "IMU")
        except (Exception, RecursionError) as error:  # noqa: BLE001  (whatever the peer raises is its figure)
            return f"raises {type(error).__name__}"
    return f"indexes {count} ({100 * count / len(undamaged):.1f} %)"
