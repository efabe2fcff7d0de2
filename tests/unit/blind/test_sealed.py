"""What was sealed is what is here."""

from __future__ import annotations

import json
from pathlib import Path

from mavcal.calib.blind.seal import generator_sha256

SEALS = Path(__file__).resolve().parents[3] / "bench" / "seals" / "gap.json"


def test_the_generator_is_the_one_that_was_sealed():
    assert json.loads(SEALS.read_text())["gap-seal"]["generator_sha256"] == generator_sha256()
