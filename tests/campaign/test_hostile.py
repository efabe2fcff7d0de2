"""A slice of ``python -m bench.hostile``: what floods a link harms neither the service nor its vehicle."""

from __future__ import annotations

import pytest

from bench.hostile import main


@pytest.mark.long
@pytest.mark.timeout(120)
def test_hostile_datagrams_neither_silence_the_vehicle_nor_make_it_writable(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["30000"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("30000 datagrams")
    assert "silent False, writable False" in said
