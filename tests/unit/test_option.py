from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.option import Option

RATE = Option("rate", float, 1.0, "of the table", "deg/s", 0.0, 10.0)
DEGREE = Option("degree", int, 3, "of the polynomial")
SWITCH = Option("extend", bool, default=False, help="goes on")
FORM = Option("form", ("upper", "symmetric"), "upper", "of the matrix")
TEXT = Option("order", str, None, "of the rings")


@pytest.mark.parametrize(
    ("option", "value", "taken"),
    [
        (RATE, 2, 2.0),
        (RATE, np.int64(2), 2.0),
        (RATE, "2.5", 2.5),
        (DEGREE, 4.0, 4),
        (DEGREE, "4", 4),
        (SWITCH, True, True),
        (FORM, "symmetric", "symmetric"),
        (TEXT, "a,b", "a,b"),
        (TEXT, 30.0, "30.0"),
    ],
)
def test_a_value_becomes_the_options_type(option: Option, value: Any, taken: Any) -> None:
    found = option.check(option.from_text(value))
    assert found == taken
    assert type(found) is type(taken)


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        (RATE, 11.0, "rate is 11 deg/s; it must lie between 0 and 10"),
        (RATE, "2.5", "finite number deg/s"),
        (RATE, True, "finite number"),
        (RATE, math.inf, "finite number"),
        (RATE, 10**400, "finite number"),
        (RATE, [1.0], "finite number"),
        (DEGREE, 3.5, r"degree must be a whole number \(of the polynomial\)"),
        (SWITCH, 1.0, "extend is a switch"),
        (FORM, "lower", "form is one of upper, symmetric"),
        (TEXT, True, "order"),
    ],
)
def test_what_is_of_another_type_is_refused_by_name(option: Option, value: Any, says: str) -> None:
    with pytest.raises(InvalidInputError, match=says):
        option.check(value)


@pytest.mark.parametrize("value", ["three", "3.0", "1e1", ""])
def test_a_text_that_is_no_number_stays_one_and_is_refused(value: str) -> None:
    assert DEGREE.from_text(value) == value
    with pytest.raises(InvalidInputError, match="degree"):
        DEGREE.check(DEGREE.from_text(value))
