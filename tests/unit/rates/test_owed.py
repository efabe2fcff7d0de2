from __future__ import annotations

from pathlib import Path

import pytest

from mavcal.service.errors import DiskFull
from mavcal.service.rates.owed import OwedRates


def test_what_is_owed_is_known_to_the_next_run_until_it_was_paid(tmp_path: Path) -> None:
    path = tmp_path / "owed.json"
    owed = OwedRates(path)
    assert owed.all() == {}
    owed.put("v1", {27: -1, 116: 20_000})
    owed.put("v2", {26: 0})
    assert OwedRates(path).all() == {"v1": {27: -1, 116: 20_000}, "v2": {26: 0}}
    owed.put("v1", {})
    assert OwedRates(path).all() == {"v2": {26: 0}}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"v": 3}', '{"v": {"a": 1}}', "null"])
def test_a_damaged_file_counts_as_empty_and_is_written_over(tmp_path: Path, text: str) -> None:
    path = tmp_path / "owed.json"
    path.write_text(text)
    owed = OwedRates(path)
    assert owed.all() == {}
    owed.put("v1", {27: -1})
    assert OwedRates(path).all() == {"v1": {27: -1}}


def test_what_cannot_be_kept_is_not_owed(tmp_path: Path) -> None:
    owed = OwedRates(tmp_path / "absent" / "owed.json")
    with pytest.raises(DiskFull, match="cannot be kept"):
        owed.put("v1", {27: -1})
    assert owed.all() == {}
