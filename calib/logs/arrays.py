"""Columns of numbers out of files of arrays: .npz and .mat.

What an array says of itself is compared with what is there, and with what all of them will take, before any is read.
"""

from __future__ import annotations

import math
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.columns import Array, TableColumns
from mavcal.calib.logs.matlab import matlab_arrays

MOST_UNFOLDED: Final = 1 << 26, 50
"""Bytes that the columns of a file may take, plus this many times the size of the file."""
TEXT_BYTES: Final = 64
"""What a text takes beside its characters."""
PLAIN_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""How ``numpy.savez`` packs; the others unfold without a bound on a single step."""


@dataclass(frozen=True)
class _Stored:
    """An array that is read when it is needed."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], NDArray[Any]]

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def held(self) -> int:
        """Bytes of its columns."""
        return self.size * (self.dtype.itemsize + TEXT_BYTES if self.dtype.kind in "US" else 8)


def npz_columns(path: Path) -> TableColumns:
    """The arrays of an .npz; one of shape (N, k) called a becomes a_0, a_1 ... (accel, gyro, mag: a_x, a_y, a_z).

    Raises
    ------
    UnreadableError
        If the file is damaged, or its arrays are not of numbers.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            try:
                stored = _members(archive)
            except MemoryError as error:  # what Python's parser says of a header that is nested too deep
                raise UnreadableError("the .npz is damaged: the header of an array cannot be read") from error
            _check_unfolded(sum(array.held for array in stored.values()), path.stat().st_size)
            return _from_arrays(stored)
    except (UnreadableError, MemoryError):
        raise
    except Exception as error:  # zipfile and numpy meet damage with a dozen kinds of them
        raise UnreadableError(
            f"the .npz cannot be read ({str(error)[:200]}): write it with numpy.savez and arrays of numbers"
        ) from error


def mat_columns(path: Path) -> TableColumns:
    """The arrays of a MATLAB file, in the same manner as :func:`npz_columns`.

    Raises
    ------
    UnreadableError
        If the file is damaged, or of MATLAB's 7.3 format (HDF5).
    """
    data = memoryview(np.memmap(path, dtype=np.uint8, mode="r"))  # type: ignore[arg-type]
    if data[0] != ord("M"):
        raise UnreadableError("the .mat is of MATLAB's 7.3 format: save it with -v7, or as .csv")
    arrays = matlab_arrays(data, lambda total: _check_unfolded(total, len(data)))
    stored = {name: _Stored(a.shape, a.dtype, lambda a=a: a) for name, a in arrays.items()}  # type: ignore[misc]
    _check_unfolded(sum(array.held for array in stored.values()), len(data))
    return _from_arrays(stored)


def _members(archive: zipfile.ZipFile) -> dict[str, _Stored]:
    """The arrays of the archive, none of them read yet."""
    found = {}
    for member in archive.infolist():
        if not member.filename.endswith(".npy"):
            continue
        if member.compress_type not in PLAIN_METHODS:
            raise UnreadableError(f"the .npz is packed in a way that is not read (method {member.compress_type})")
        with archive.open(member) as opened:
            version = np.lib.format.read_magic(opened)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = read(opened)
            room = member.file_size - opened.tell()
        if dtype.hasobject:
            raise UnreadableError(f"{member.filename} holds objects of Python: save numbers, or dates as datetime64")
        if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > room:
            raise UnreadableError(f"the .npz is damaged: {member.filename} claims {shape} of {dtype}")

        def load(member: zipfile.ZipInfo = member) -> NDArray[Any]:
            with archive.open(member) as opened:
                return np.asarray(np.lib.format.read_array(opened, allow_pickle=False))

        found[member.filename.removesuffix(".npy")] = _Stored(shape, dtype, load)
    return found


def _check_unfolded(total: int, size: int) -> None:
    least, times = MOST_UNFOLDED
    if total > least + times * size:
        raise UnreadableError(f"the file of {size} bytes unfolds to {total >> 20} MB or more: that is no recording")


def _from_arrays(arrays: Mapping[str, _Stored]) -> TableColumns:
    flat = {name: a for name, a in arrays.items() if len(a.shape) in (1, 2) and a.size > 1}
    if not flat:
        raise UnreadableError("the file holds no arrays")
    rows = Counter(max(a.shape) for a in flat.values()).most_common(1)[0][0]
    names: list[str] = []
    values: list[Array] = []
    texts: dict[int, tuple[str, ...]] = {}
    for name, stored in flat.items():
        if rows not in stored.shape and stored.size != rows:
            continue
        array = stored.load()
        if array.size == rows:
            array = array.reshape(rows, 1)
        elif array.shape[0] != rows:
            array = array.T
        for k in range(array.shape[1]):
            column = array[:, k]
            if column.dtype.kind in "US":
                texts[len(values)] = tuple(str(cell) for cell in column)
                values.append(np.full(rows, np.nan))
            elif column.dtype.kind in "mM":
                values.append(_seconds(column))
            elif column.dtype.kind in "biuf":
                values.append(column.astype(np.float64))
            else:
                continue
            names.append(_array_name(name, k, array.shape[1]))
    if not values:
        raise UnreadableError("the file holds no arrays of numbers")
    return TableColumns(tuple(names), tuple(values), texts)


def _seconds(column: NDArray[Any]) -> Array:
    """Dates and durations as s from the first on, nan where there is none."""
    fine = np.datetime_data(column.dtype)[0] in {"ns", "ps", "fs", "as"}
    column = column.astype(f"{column.dtype.kind}8[{'ns' if fine else 'us'}]")
    there = ~np.isnat(column)
    seconds = np.full(len(column), np.nan)
    if there.any():
        seconds[there] = (column[there] - column[there][0]) / np.timedelta64(1, "s")
    return seconds


def _array_name(name: str, column: int, width: int) -> str:
    if width == 1:
        return name
    if width == 3 and name.rstrip("0123456789") in {"accel", "gyro", "mag"}:
        return f"{name}_{'xyz'[column]}"
    if width == 4 and name == "q":
        return f"q_{'wxyz'[column]}"
    return f"{name}_{column}"
