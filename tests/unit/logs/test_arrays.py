"""MATLAB 5 files: the same numbers as scipy's reader, and nothing but one sentence where a file lies."""

from __future__ import annotations

import io
import random
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from mavcal.calib.errors import UnreadableError
from mavcal.calib.logs.arrays import mat_columns, matlab_arrays

KILLER = (138, 14), (176, 255)
"""Byte and value: with these the file below ends scipy's reader with SIGSEGV."""


def saved(values: dict[str, object], *, packed: bool = False) -> bytes:
    file = io.BytesIO()
    scipy.io.savemat(file, values, do_compression=packed)
    return file.getvalue()


def arrays(data: bytes) -> dict[str, np.ndarray]:
    return matlab_arrays(memoryview(data), lambda _total: None)


@pytest.mark.parametrize("packed", [False, True])
def test_arrays_are_those_of_scipy(packed):
    rng = np.random.default_rng(3)
    numbers = {
        f"{kind}{n}": (100 * rng.normal(size=(n, 3))).astype(kind)
        for kind in ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
        for n in (1, 7)
    }
    other = {
        "cells": np.array([1, "a"], dtype=object),
        "struct": {"a": 1.0},
        "z": np.ones(3) * 1j,
        "cube": np.ones((2, 2, 2)),
    }
    data = saved({**numbers, **other, "b": np.array([True, False]), "text": np.array(["one", "three"])}, packed=packed)
    found = arrays(data)
    expected = scipy.io.loadmat(io.BytesIO(data))
    for name in (*numbers, "b"):
        np.testing.assert_array_equal(found[name], expected[name])
    assert found["text"].tolist() == ["one", "three"]
    assert set(found) == {*numbers, "b", "text"}


def test_the_other_byte_order_is_read():
    flags, size = np.array([6, 8, 6, 0], ">u4").tobytes(), np.array([5, 8, 2, 3], ">u4").tobytes()
    name = np.array([0x00010001], ">u4").tobytes() + b"a\0\0\0"
    numbers = np.array([9, 48], ">u4").tobytes() + np.arange(6, dtype=">f8").tobytes()
    matrix = flags + size + name + numbers
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
    data = header + np.array([14, len(matrix)], ">u4").tobytes() + matrix
    np.testing.assert_array_equal(arrays(data)["a"], np.arange(6.0).reshape(2, 3, order="F"))


def test_the_real_files_are_read_as_by_scipy(shared_data):
    for path in sorted(shared_data.rglob("*.mat")):
        if not path.read_bytes().startswith(b"MATLAB"):
            continue  # a text of that name
        found = arrays(path.read_bytes())
        expected = {k: v for k, v in scipy.io.loadmat(path).items() if not k.startswith("__") and v.dtype.kind in "fiu"}
        assert found.keys() >= expected.keys()
        for name, values in expected.items():
            np.testing.assert_array_equal(found[name], values)


def test_the_file_that_ends_scipy_is_one_sentence(tmp_path):
    data = bytearray(saved({"a": np.arange(9.0)}))
    for place, value in KILLER:
        data[place] = value
    (tmp_path / "a.mat").write_bytes(data)
    with pytest.raises(UnreadableError, match="cannot be read"):
        mat_columns(tmp_path / "a.mat")


def test_mutations_are_arrays_or_one_sentence(tmp_path):
    sound = [
        saved({"accel": np.ones((4, 3)), "t": np.arange(4.0), "s": "ab"}, packed=packed) for packed in (False, True)
    ]
    rng = random.Random(5)
    refused = []
    for number in range(4000):
        data = bytearray(sound[number % 2])
        for _ in range(rng.randint(1, 4)):
            data[rng.randrange(124, len(data))] = rng.choice(
                (0, 1, 2, 5, 6, 7, 9, 14, 15, 128, 255, rng.randrange(256))
            )
        try:
            assert all(
                a.size < 1000 for a in arrays(bytes(data[: rng.choice((len(data), rng.randrange(len(data))))])).values()
            )
        except UnreadableError as error:
            refused.append(str(error))
    assert len(refused) > 1000
    assert max(map(len, refused)) < 300


def test_what_unfolds_is_stopped_before_it_is_there(tmp_path):
    path = Path(tmp_path / "bomb.mat")
    scipy.io.savemat(path, {"a": np.zeros((20_000_000, 1), np.int8)}, do_compression=True)
    with pytest.raises(UnreadableError, match="unfolds to"):
        mat_columns(path)
