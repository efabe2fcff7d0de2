"""A seeded slice of the mutated files: every reader answers each with a recording or the typed refusal."""

from __future__ import annotations

import resource

import pytest

from tests.campaign.fuzz import FORMATS, campaign


@pytest.mark.parametrize("name", list(FORMATS))
def test_mutated_files_are_recordings_or_refusals(name, tmp_path):
    row = campaign(name, 60, 7, tmp_path)
    assert (row.defects, row.deaths, row.memory) == (0, 0, 0), row.seen
    assert row.read + row.refused == row.runs == 60
    assert row.refused
    own_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss >> 10  # a forked child begins with it
    assert row.peak_mib < own_mib + 256
