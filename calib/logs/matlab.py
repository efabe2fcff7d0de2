"""The arrays of numbers and texts in a MATLAB 5 file, read without native code that trusts what a file says.

A file is a chain of elements, each with its kind and its size; every size is checked against what is there before
anything is taken from it. Cells, structures, sparse, complex and deeper arrays hold no table and are stepped over.
``scipy.io.loadmat`` (1.17.1) ends the process by SIGSEGV: on ``savemat(file, {"a": np.arange(9.0)})`` with 14 at byte
138 and 255 at byte 176, and on 16 of 2000 small files that were damaged at random.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.errors import UnreadableError

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


def matlab_arrays(data: memoryview, unfolded: Unfolded) -> dict[str, NDArray[Any]]:
    """Name and array of every real matrix of numbers, and of texts one a row.

    Parameters
    ----------
    data
        The file.
    unfolded
        Is told how many bytes the file has unfolded to so far, and raises if they are too many.

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
    """Kind and content of one element after the other; `packed`: none is filled up to 8 bytes if compressed."""
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
    """Name and array; None if it is of a class that holds no table."""
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
    """The rows of a matrix of characters, which lie in it column by column."""
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
