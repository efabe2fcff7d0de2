"""Probabilities of names: between zero and one, larger with evidence, smaller beside what has no name."""

from __future__ import annotations

import itertools

import pytest

from calib.gap.believed import believed

GAINS = (0.0, 10.0, 50.0, 200.0, 1000.0, 1e8)


@pytest.mark.parametrize("unknown", [False, True])
def test_more_evidence_and_fewer_rivals_make_a_name_likelier(unknown):
    for gain in GAINS:
        chances = [believed(p, gain, beside_unknown=unknown) for p in (0.0, 0.3, 0.7, 1.0)]
        assert chances[0] == 0.0
        assert all(a < b < 1.0 for a, b in itertools.pairwise(chances))
    over_gains = [believed(0.8, gain, beside_unknown=unknown) for gain in GAINS]
    assert all(a <= b for a, b in itertools.pairwise(over_gains))


def test_beside_something_unknown_a_name_is_doubted():
    assert all(believed(0.9, g, beside_unknown=True) < believed(0.9, g, beside_unknown=False) for g in GAINS)
