"""Combinations of changes, weighed by points whose distances are given."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcal.calib.firmware.plan import ProofVerdict
from mavcal.calib.firmware.proof.hypotheses import combinations_of, judge


def weigh(data, effects):
    """Judge changes whose refusal moves the discrepancy by `effects`; `data` is the discrepancy if all is applied."""

    def whitened(refused):
        return np.array(data, dtype=np.float64) + sum(
            (np.array(effects[n], dtype=np.float64) for n in refused), np.zeros(len(data))
        )

    return judge(list(effects), whitened)


def verdicts(data, effects):
    return {name: found.value for name, found in weigh(data, effects).verdicts.items()}


@pytest.mark.parametrize(
    ("data", "effect", "verdict"),
    [
        (0.0, 2.99, "not_observable"),
        (0.0, 3.0, "consistent"),
        (0.0, 3.28, "consistent"),
        (0.0, 3.30, "proved"),
        (0.01, -3.29, "consistent"),
        (-0.02, 3.28, "consistent"),
        (-3.3, 3.3, "contradicted"),
        (-3.28, 3.28, "consistent"),
        (-3.8, 10.0, "proved"),  # nearer to the new value, however far from both
        (-6.2, 10.0, "contradicted"),
    ],
)
def test_one_change_is_told_by_how_far_the_data_lie_towards_the_other(data, effect, verdict):
    assert verdicts([data], {"A": [effect]})["A"] == verdict


def test_how_far_apart_the_two_are_is_said():
    found = weigh([0.0, 0.0], {"A": [3.0, 4.0], "B": [0.0, 0.0]})
    assert found.distance == {"A": 5.0, "B": 0.0}
    assert found.explained
    assert found.verdicts == {"A": ProofVerdict.PROVED, "B": ProofVerdict.NOT_OBSERVABLE}


def test_what_no_combination_explains_is_judged_by_its_own_scatter():
    # the chance of 15.14 is one in 10000 for one number: 3.8906 standard deviations
    assert weigh([3.88], {"A": [20.0]}).explained
    assert not weigh([3.90], {"A": [20.0]}).explained
    far = weigh([4.5, 0.0], {"A": [0.0, 20.0], "B": [0.0, 0.5]})
    assert not far.explained
    assert far.verdicts == {"A": ProofVerdict.CONSISTENT, "B": ProofVerdict.NOT_OBSERVABLE}
    assert far.distance["A"] == pytest.approx(20.0 / (4.5 / math.sqrt(2.0)))
    between = weigh([-10.0, 0.0], {"A": [20.0, 0.0]})  # as far from the new value as from the old one
    assert not between.explained
    assert between.verdicts == {"A": ProofVerdict.NOT_OBSERVABLE}
    old = weigh([-200.0, 5.0], {"A": [200.0, 0.0]})  # the old one fits far better, whatever scatters beside
    assert not old.explained
    assert old.verdicts == {"A": ProofVerdict.CONTRADICTED}


def test_a_combination_that_no_vehicle_can_have_is_left_out():
    def whitened(refused):
        if "A" in refused and "B" not in refused:
            return None  # A's old value does not fit beside B's new one
        return np.array([10.0 * ("B" in refused)])

    found = judge(["A", "B"], whitened)
    assert found.verdicts == {"A": ProofVerdict.PROVED, "B": ProofVerdict.PROVED}  # without B no A
    assert found.alone == {"A": frozenset({"A", "B"}), "B": frozenset({"B"})}
    only = judge(["A"], lambda refused: None if refused else np.zeros(1))
    assert (only.verdicts, only.alone) == ({"A": ProofVerdict.NOT_OBSERVABLE}, {})


def test_two_that_look_alike_cannot_be_told_apart():
    found = verdicts([-10.0], {"A": [10.0], "B": [10.0]})
    assert found == {"A": "contradicted", "B": "contradicted"}  # one of them is, and both are named
    assert verdicts([0.0], {"A": [10.0], "B": [-10.0]}) == {"A": "consistent", "B": "consistent"}


def test_the_fewest_vectors_are_blamed():
    data = [-10.0, -10.0]
    effects = {"INS_ACCOFFS_X": [10.0, 0.0], "INS_ACCOFFS_Y": [0.0, 10.0], "OTHER": [10.0, 10.0]}
    assert verdicts(data, effects)["OTHER"] == "contradicted"


@pytest.mark.parametrize(("count", "size"), [(1, 2), (3, 8), (8, 256)])
def test_few_changes_are_combined_in_every_way(count, size):
    names = [f"N{chr(97 + k)}" for k in range(count)]
    found = combinations_of(names)
    assert len(found) == len(set(found)) == size
    assert found[0] == frozenset()


def test_many_are_combined_by_pairs_and_vectors():
    names = [f"{stem}_{a}" for stem in ("INS_ACCOFFS", "INS_ACCSCAL", "INS_GYROFFS") for a in "XYZ"]
    found = combinations_of(names)
    by_size = {size: sum(len(h) == size for h in found) for size in range(10)}
    # none, singles, pairs; a whole vector; two vectors; all but one; all
    assert by_size == {0: 1, 1: 9, 2: math.comb(9, 2), 3: 3, 4: 0, 5: 0, 6: 3, 7: 0, 8: 9, 9: 1}
    assert frozenset(names[:3]) in found
    assert frozenset(names[3:]) in found


@pytest.mark.parametrize(
    ("names", "groups"),
    [
        ([f"CAL_ACC0_{a}{part}" for part in ("OFF", "SCALE", "ODIAG") for a in "XYZ"], 3),
        ([f"TC_G0_X{k}_{a}" for k in range(3) for a in "012"], 3),
        (["AHRS_ORIENTATION", *(f"ALONE_{k}" for k in "ABCDEFGH")], 9),
    ],
)
def test_a_vector_is_known_by_its_name(names, groups):
    wholes = [h for h in combinations_of(names) if len(h) == 3]
    assert len(wholes) == (groups if groups == 3 else 0)
