"""What a firmware does, stores and is called is known in ``calib.firmware``; a procedure asks for it."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavcal.calib.firmware import turning_spoils

PROCEDURES = Path(__file__).resolve().parents[3] / "calib" / "procedures"
FIRMWARE = re.compile(r"ardupilot|px4|firmwares", re.IGNORECASE)
PARAMETER = re.compile(r"\b[A-Z][A-Z0-9]+_[A-Z0-9_]+\b")
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


def facts(source: str) -> Iterator[str]:
    """Texts that name an autopilot or a parameter, and what is said of a constant; what a function tells its reader of
    itself does not count.
    """
    tree = ast.parse(source)
    told = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, DOCUMENTED) and _documented(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told:
            yield from (match[0] for rule in (FIRMWARE, PARAMETER) for match in rule.finditer(node.value))


def _documented(node: ast.AST) -> bool:
    first = node.body[0] if getattr(node, "body", None) else None
    return isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)


def test_no_procedure_states_a_fact_of_a_firmware() -> None:
    sources = {path.name: path.read_text(encoding="utf-8") for path in sorted(PROCEDURES.glob("*.py"))}
    assert "mag.py" in sources
    assert {name: found for name, source in sources.items() if (found := list(facts(source)))} == {}


@pytest.mark.parametrize(
    "source",
    [
        "x = parameters.get('IMU_GYRO_CAL_EN')",
        "x = autopilot in ('ardupilot', 'px4')",
        'LARGEST = 180.0\n"""uT. ArduPilot refuses to arm beyond."""',
        'NARROWEST = 10.0\n"""Both firmwares ask for more."""',
    ],
)
def test_a_fact_is_seen(source: str) -> None:
    assert list(facts(source))
    assert not list(facts('"""PX4 streams CAL_GYRO0_ID."""\nx = "Leave it alone."'))


def test_a_turn_spoils_a_capture_only_where_the_vehicle_estimates_its_offsets_meanwhile() -> None:
    assert "IMU_GYRO_CAL_EN = 1" in turning_spoils({"IMU_GYRO_CAL_EN": 1})
    assert turning_spoils({"IMU_GYRO_CAL_EN": 0}) == turning_spoils({"INS_GYR_CAL": 1}) == turning_spoils({}) == ""
