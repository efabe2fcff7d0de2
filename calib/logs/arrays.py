"""Reads columns of numbers from files of arrays, .npz and .mat.

Before any array is read, the declared sizes are compared with the file's content and with the memory limit.

A MATLAB 5 file, a chain of elements with kind and size, is read without native code. Cells, structures, sparse, complex
and deeper arrays are not tables and are skipped. ``scipy.io.loadmat`` (1.17.1) ends the process by SIGSEGV: on
``savemat(file, {"a": np.arange(9.0)})`` with 14 at byte 138 and 255 at byte 176, and on 16 of 2000 small files that
were damaged at random.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.columns import Array, TableColumns

MOST_UNFOLDED: Final = 1 << 26, 50
"""Most bytes that the columns of a file may take, and the further bytes for each byte of the file."""
TEXT_BYTES: Final = 64
"""Bytes of a text in addition to its characters."""
PLAIN_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Compression methods of ``numpy.savez``; others decompress without a bound on a single step."""
HEADER: Final = 128
VERSION_73: Final = 0x0200
COMPRESSED, MATRIX, INT8, INT32, UINT32, UTF8 = 15, 14, 1, 5, 6, 16
DTYPES: Final = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    16: "u1",
    17: "u2",
    18: "u4",
}
"""Kinds of numbers, and of characters."""
CHARACTERS: Final = 4
NUMBERS: Final = range(6, 16)
"""Classes of arrays: double, single, and the integers."""
COMPLEX: Final = 0x0800
MOST_CODE: Final = 0x10FFFF
_PIECE = 1 << 20
Unfolded = Callable[[int], None]


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
    """The arrays of a MATLAB file, named as by :func:`npz_columns`.

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
    """Dates and durations as seconds since the first one, nan where there is none."""
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


def matlab_arrays(data: memoryview, unfolded: Unfolded) -> dict[str, NDArray[Any]]:
    """Name and array of every real numeric matrix, and of every matrix with one text a row.

    Parameters
    ----------
    data
        The file.
    unfolded
        Called with the number of bytes decompressed so far; raises if they are too many.

    Raises
    ------
    UnreadableError
        If the file is damaged or of another version.
    """
    if len(data) < HEADER:
        raise _damaged("it ends within its header")
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]))
    if order is None:
        raise _damaged("its header states no byte order")
    (version,) = struct.unpack_from(f"{order}H", data, 124)
    if version == VERSION_73:
        raise UnreadableError("the .mat is of MATLAB's 7.3 format: save it with -v7, or as .csv")
    found: dict[str, NDArray[Any]] = {}
    total = 0
    for kind, body in _elements(data[HEADER:], order, packed=True):
        if kind == COMPRESSED:
            content = _unpacked(body, total, unfolded)
            total += len(content)
            inner = next(iter(_elements(content, order)), (0, memoryview(b"")))
        else:
            inner = kind, body
        if inner[0] != MATRIX:
            continue
        named = _matrix(inner[1], order)
        if named is not None:
            found[named[0]] = named[1]
    return found


def _elements(data: memoryview, order: str, *, packed: bool = False) -> Iterator[tuple[int, memoryview]]:
    """Kind and content of each element; `packed`: compressed elements are not padded to 8 bytes."""
    place = 0
    while place + 8 <= len(data):
        word, size = struct.unpack_from(f"{order}II", data, place)
        if word >> 16:  # a small element: kind, size and up to four bytes in eight
            kind, size, begin = word & 0xFFFF, word >> 16, place + 4
            if size > 4:
                raise _damaged(f"a small element claims {size} bytes")
            following = place + 8
        else:
            kind, begin = word, place + 8
            following = begin + size + (0 if packed and kind == COMPRESSED else -size % 8)
        if begin + size > len(data):
            raise _damaged(f"an element claims {size} bytes where {len(data) - begin} are left")
        yield kind, data[begin : begin + size]
        place = following
    if place < len(data):
        raise _damaged("it ends within an element")


def _unpacked(body: memoryview, before: int, unfolded: Unfolded) -> memoryview:
    unpacker, pieces, size = zlib.decompressobj(), [], before
    packed: bytes | memoryview = body
    try:
        while packed and not unpacker.eof:
            pieces.append(unpacker.decompress(packed, _PIECE))
            size += len(pieces[-1])
            unfolded(size)
            packed = unpacker.unconsumed_tail
    except zlib.error as error:
        raise _damaged(str(error)) from error
    if not unpacker.eof:
        raise _damaged("a compressed element is cut")
    return memoryview(b"".join(pieces))


def _matrix(body: memoryview, order: str) -> tuple[str, NDArray[Any]] | None:
    """Name and array; None for a class that cannot be a table."""
    parts = _elements(body, order)
    flags = _part(parts, {UINT32}, "its class")
    if len(flags) < 8:
        raise _damaged("an array does not say its class")
    (word,) = struct.unpack_from(f"{order}I", flags, 0)
    of = word & 0xFF
    if (of != CHARACTERS and of not in NUMBERS) or word & COMPLEX:
        return None
    size = _part(parts, {INT32}, "its size")
    shape = np.frombuffer(size[: len(size) & ~3], f"{order}i4").tolist()
    name = bytes(_part(parts, {INT8, UTF8}, "its name")).decode("utf-8", "replace")
    if len(shape) < 2 or min(shape) < 0:
        raise _damaged(f"the array {name} claims to be of {shape}")
    if len(shape) > 2:
        return None
    kind, content = next(parts, (0, memoryview(b"")))
    if kind not in DTYPES:
        raise _damaged(f"the numbers of {name} are of no known kind ({kind})")
    dtype = np.dtype(f"{order}{DTYPES[kind]}")
    count = math.prod(shape)
    if kind == UTF8 and of == CHARACTERS:
        return _texts(name, bytes(content).decode("utf-8", "replace"), shape)
    if count * dtype.itemsize != len(content):
        raise _damaged(f"the array {name} claims {shape} of {dtype.name} in {len(content)} bytes")
    array = np.frombuffer(content, dtype)
    if of != CHARACTERS:
        return name, array.reshape(shape, order="F")
    if dtype.kind != "u" or (count and int(array.max()) > MOST_CODE):
        raise _damaged(f"the text {name} is of no characters")
    return _texts(name, "".join(map(chr, array.tolist())), shape)


def _texts(name: str, text: str, shape: list[int]) -> tuple[str, NDArray[Any]] | None:
    """The rows of a character matrix, which is stored column by column."""
    rows, width = shape
    if rows * width != len(text):
        return None
    return name, np.array([text[row::rows].rstrip() for row in range(rows)], dtype=str)


def _part(parts: Iterator[tuple[int, memoryview]], kinds: set[int], what: str) -> memoryview:
    kind, content = next(parts, (0, memoryview(b"")))
    if kind not in kinds:
        raise _damaged(f"an array does not say {what}")
    return content


def _damaged(why: str) -> UnreadableError:
    return UnreadableError(f"the .mat cannot be read: {why}; save it again with -v7, or as .csv")
