"""What was sealed is what is here."""

from __future__ import annotations

import json
from pathlib import Path

from mavcal.calib.blind.seal import generator_sha256

SEAL = Path(__file__).resolve().parents[3] / "docs" / "gap-seal.json"


def test_the_generator_is_the_one_that_was_sealed():
    assert json.loads(SEAL.read_text())["generator_sha256"] == generator_sha256()
