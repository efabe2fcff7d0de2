from __future__ import annotations

import json

import pytest

from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.service.api.views import procedure_model


@pytest.mark.parametrize("kind", PROCEDURES)
def test_the_options_of_a_procedure_are_told_in_json(kind: str) -> None:
    told = json.loads(procedure_model(PROCEDURES[kind]).model_dump_json())
    assert [option["name"] for option in told["options"]] == [option.name for option in PROCEDURES[kind].options]
    assert all(list(option) == ["name", "default", "help", "unit", "low", "high"] for option in told["options"])
