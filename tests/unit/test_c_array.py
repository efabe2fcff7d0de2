from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mavcal.calib.c_array import c_array, homogeneous
from mavcal.calib.errors import InvalidInputError
from tests.examples import examples

FINITE = st.floats(-1e6, 1e6)


@settings(max_examples=examples(25))
@given(arrays(np.float64, (3, 3), elements=FINITE), arrays(np.float64, 3, elements=FINITE))
def test_a_correction_as_one_matrix_does_the_same(matrix: np.ndarray, offset: np.ndarray) -> None:
    measured = np.array([1.0, -2.0, 3.0])
    whole = homogeneous(matrix, offset) @ np.append(measured, 1.0)
    np.testing.assert_allclose(whole[:3], matrix @ (measured - offset), rtol=1e-9, atol=1e-3)
    assert whole[3] == 1.0


@settings(max_examples=examples(25))
@given(arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 4)), elements=st.floats(-1e300, 1e300)))
def test_every_digit_comes_back(values: np.ndarray) -> None:
    text = c_array("mag_0", values)
    rows, columns = values.shape
    assert text.startswith(f"static const double mag_0[{rows}][{columns}] = {{")
    numbers = [float(word) for word in re.findall(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", text.split("= {", 1)[1])]
    np.testing.assert_array_equal(np.reshape(numbers, values.shape), values)


@pytest.mark.parametrize("name", ["", "0mag", "mag-0", "mag 0", "mag_0\n", "größe"])
def test_a_name_is_one_that_c_takes(name: str) -> None:
    with pytest.raises(InvalidInputError, match="no name of an array in C"):
        c_array(name, np.eye(2))


@pytest.mark.parametrize("values", [[1.0], np.zeros((2, 2, 2)), [[np.nan]], [[np.inf, 1.0]]])
def test_an_array_has_finite_rows_and_columns(values: object) -> None:
    with pytest.raises(InvalidInputError, match="finite rows and columns"):
        c_array("a", values)  # type: ignore[arg-type]
