"""Where the messages of a binary DataFlash log begin.

There is no checksum: a message is accepted if another one follows where it ends. Candidates are found for a whole block
of the file at once. An unbroken chain of messages needs no more. Only breaks are walked one by one: damage, and
payloads that look like a header.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.logs.dataflash.formats import FMT, FMT_LENGTH, FMT_TYPE, HEADER, MAGIC, Format, read_fmt

Bytes = NDArray[np.uint8]
Offsets = NDArray[np.int64]

BLOCK: Final = 1 << 22
"""Bytes that are searched at once; a block fits the processor's cache."""
LONGEST: Final = 256
"""Longest message, bytes: the length field has one byte."""


@dataclass
class Index:
    """Result of a scan.

    Parameters
    ----------
    formats
        Definition by type number.
    parts
        By type number: pairs of the file offset of a block, and the messages' offsets behind it, in order.
    counts
        Messages by type number, indexed or not.
    skipped
        Start and length of the stretches that belong to no intact message.
    """

    formats: dict[int, Format] = field(default_factory=lambda: {FMT_TYPE: FMT})
    parts: dict[int, list[tuple[int, NDArray[np.uint32]]]] = field(default_factory=dict)
    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(256, dtype=np.int64))
    skipped: list[tuple[int, int]] = field(default_factory=list)

    @property
    def skipped_bytes(self) -> int:
        """Number of skipped bytes."""
        return sum(length for _, length in self.skipped)


def scan(data: Bytes, names: Collection[str] | None = None) -> Index:
    """Find every message of `data`; only those called one of `names` are indexed (None: all)."""
    index = Index()
    lengths = np.zeros(256, dtype=np.int64)
    lengths[FMT_TYPE] = FMT_LENGTH
    expected = 0
    for base in range(0, len(data), BLOCK):
        window = data[base : base + BLOCK + 2 * LONGEST]
        begins = _candidates(window)
        _define(index, lengths, window, begins)
        limit = min(BLOCK, len(data) - base)
        last = base + len(window) == len(data)
        walk = _Walk(window, begins, lengths, last=last)
        expected = base + walk.run(expected - base, limit)
        index.skipped.extend((base + start, length) for start, length in walk.skipped)
        _file(index, base, walk.accepted, window, names)
    if expected < len(data):
        index.skipped.append((expected, len(data) - expected))
    index.skipped = _merged(index.skipped)
    return index


def _candidates(window: Bytes) -> Offsets:
    """Offsets of the two magic bytes that leave room for a type."""
    begins = np.flatnonzero(window[: max(0, len(window) - HEADER + 1)] == MAGIC[0])
    return np.asarray(begins[window[begins + 1] == MAGIC[1]])


def _define(index: Index, lengths: Offsets, window: Bytes, begins: Offsets) -> None:
    """Take up the definitions of a block, before its messages are walked."""
    here = begins[window[begins + 2] == FMT_TYPE]
    for begin in here.tolist():
        _adopt(index, lengths, window, begin)
        following = begin + FMT_LENGTH
        # definitions follow one another, so one with a damaged header can be recovered, with its messages
        while following + HEADER <= len(window) and (window[following : following + 2] != MAGIC).sum() == 1:
            if not _adopt(index, lengths, window, following):
                break
            following += FMT_LENGTH


def _adopt(index: Index, lengths: Offsets, window: Bytes, begin: int) -> bool:
    """Adopt the definition at `begin`; returns whether it is valid."""
    if begin + FMT_LENGTH > len(window):
        return False
    made = read_fmt(window[begin + HEADER : begin + FMT_LENGTH].tobytes())
    if made is None or index.formats.get(made.type, made).letters != made.letters:
        return False
    if made.type not in index.formats:
        index.formats[made.type] = made
        lengths[made.type] = made.length
    return True


class _Walk:
    """Follows the chain of messages through one block.

    Parameters
    ----------
    window
        The block, with enough bytes behind it for a message that begins in it and one more header.
    begins
        Offsets in the block at which a message may begin.
    lengths
        Length by type, 0 for unknown ones.
    last
        Whether the file ends with the window.
    """

    def __init__(self, window: Bytes, begins: Offsets, lengths: Offsets, *, last: bool) -> None:
        known = lengths[window[begins + 2]]
        keep = known > 0
        self._begins = begins[keep]
        self._ends = self._begins + known[keep]
        self._window, self._lengths = window, lengths
        self._file_end = len(window) if last else -1
        self._breaks = np.flatnonzero(self._ends[:-1] != self._begins[1:])
        self._pieces: list[Offsets] = []
        self.skipped: list[tuple[int, int]] = []

    @property
    def accepted(self) -> Offsets:
        """Offsets of the accepted messages, ascending."""
        return np.concatenate(self._pieces) if self._pieces else np.empty(0, dtype=np.int64)

    def run(self, expected: int, limit: int) -> int:
        """Walk from `expected` over the messages that begin before `limit`; returns where the next one is expected."""
        begins, ends = self._begins, self._ends
        stop = int(np.searchsorted(begins, limit))
        i = int(np.searchsorted(begins, expected))
        while expected < limit:
            if i >= len(begins) or begins[i] != expected:
                i = self._next_valid(i)
                if i >= stop:
                    break
                self.skipped.append((expected, int(begins[i]) - expected))
            b = self._run_end(i)
            if b >= stop:
                self._pieces.append(begins[i:stop])
                return int(ends[stop - 1])
            expected = int(ends[b])
            j = int(np.searchsorted(begins, expected))
            if self._follows(j, expected) or self._nearly_header(expected):
                self._pieces.append(begins[i : b + 1])
                i = j
            else:  # it was cut short, or overwritten up to here
                self._pieces.append(begins[i:b])
                i, expected = b + 1, int(begins[b])
        return expected

    def _run_end(self, i: int) -> int:
        """The last message of the unbroken chain that contains `i`."""
        k = int(np.searchsorted(self._breaks, i))
        return int(self._breaks[k]) if k < len(self._breaks) else len(self._begins) - 1

    def _follows(self, j: int, end: int) -> bool:
        return end == self._file_end or (j < len(self._begins) and int(self._begins[j]) == end)

    def _next_valid(self, i: int) -> int:
        """The first candidate from `i` that another one follows; the number of candidates if there is none."""
        k = int(np.searchsorted(self._valid, i))
        return int(self._valid[k]) if k < len(self._valid) else len(self._begins)

    @cached_property
    def _valid(self) -> Offsets:
        if not len(self._begins):
            return self._begins
        at = np.minimum(np.searchsorted(self._begins, self._ends), len(self._begins) - 1)
        return np.flatnonzero((self._begins[at] == self._ends) | (self._ends == self._file_end))

    def _nearly_header(self, at: int) -> bool:
        """Whether two of the three header bytes match at `at`: the damage is then after the message that ends there."""
        if at + HEADER > len(self._window):
            return False
        first, second, type_ = self._window[at : at + HEADER].tolist()
        return bool((first == MAGIC[0]) + (second == MAGIC[1]) + (self._lengths[type_] > 0) >= 2)


def _file(index: Index, base: int, begins: Offsets, window: Bytes, names: Collection[str] | None) -> None:
    """Sort the messages of a block by their type."""
    types = window[begins + 2]
    counts = np.bincount(types, minlength=256)
    index.counts += counts
    order = np.argsort(types, kind="stable")
    grouped = begins[order].astype(np.uint32)
    ends = np.cumsum(counts)
    for type_ in np.flatnonzero(counts).tolist():
        if names is None or index.formats[type_].name in names:
            found = grouped[ends[type_] - counts[type_] : ends[type_]]
            index.parts.setdefault(type_, []).append((base, found if names is None else found.copy()))


def _merged(stretches: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The stretches, with adjacent ones merged."""
    merged: list[tuple[int, int]] = []
    for start, length in stretches:
        if merged and sum(merged[-1]) == start:
            merged[-1] = merged[-1][0], merged[-1][1] + length
        elif length > 0:
            merged.append((start, length))
    return merged
