from __future__ import annotations

import itertools
import math

import pytest

from mavcal.calib.posture import tilted

DIRECTIONS = [d for d in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(d)]


def unit(direction: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(part / math.hypot(*direction) for part in direction)


@pytest.mark.parametrize(
    ("down", "words"),
    [
        ((0, 0, 1), "level"),
        ((0, 0, -1), "upside down"),
        ((1, 0, 0), "nose down"),
        ((0, -1, 0), "on its left side"),
        ((1, 0, 1), "nose half down"),
        ((0, 1, 1), "right side half down"),
        ((-1, -1, 1), "tail a third down, left side low"),
        ((1, 1, -1), "upside down, nose a third down, right side low"),
        ((1, -1, 0), "on its left side, nose half down"),
    ],
)
def test_faces_edges_and_corners_in_words(down, words):
    assert tilted(unit(down)) == words


def test_no_two_of_them_are_said_alike():
    said = [tilted(unit(direction)) for direction in DIRECTIONS]
    assert len(set(said)) == len(said) == 26
