"""Who may import whom: layers of ``calib``, ``service`` above them, and a simulator that knows nothing of either."""

from __future__ import annotations

import ast
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

LAYERS = (
    {"errors"},
    {"wire", "recording", "triad", "fit", "geometry", "attitude", "c_array", "conventions"},
    {"earth", "stats"},
    {"noise", "accel", "gyro", "thermal", "imu", "mag"},
    {"simulate", "firmware", "converted"},
    {"logs"},
    {"procedures", "gap", "flight", "blind"},
    {"report", "methods", "gap_report"},
)
"""Rooms of ``calib``, lowest first; a room imports its own layer and the ones below, never in a circle."""

ROOMS = set().union(*LAYERS)

PURE = {"numpy", "scipy", "pygeomag", "pyulog", "pymavlink", "fastcrc"}
"""Packages that ``calib`` may import besides the standard library's harmless part."""

FORBIDDEN = {
    *("socket", "asyncio", "logging", "time", "os", "sys", "subprocess", "threading", "selectors", "ssl", "signal"),
    *("multiprocessing", "concurrent", "http", "urllib", "random", "serial", "getpass", "platform", "sqlite3"),
}
"""Clocks, sockets, processes, environment: what makes a function impure."""

STANDARD = {
    *("__future__", "abc", "array", "ast", "bisect", "collections", "contextlib", "copy", "csv", "dataclasses"),
    *("datetime", "decimal", "enum", "fractions", "functools", "hashlib", "heapq", "hmac", "io", "itertools", "json"),
    *("math", "operator", "pathlib", "re", "statistics", "string", "struct", "textwrap", "types", "typing", "warnings"),
    *("zipfile", "zlib", "importlib", "numbers", "unicodedata", "html"),
}


def modules(package: str) -> dict[str, str]:
    """Dotted name and source of every module below `package`."""
    paths = sorted((ROOT / package).rglob("*.py"))
    return {
        ".".join(("mavcal", *p.relative_to(ROOT).with_suffix("").parts)): p.read_text(encoding="utf-8") for p in paths
    }


def imports(name: str, source: str) -> set[str]:
    """Everything that a module imports, relative imports resolved; ``from a import b`` counts as ``a.b``."""
    package = name.split(".")
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def room(name: str) -> str | None:
    """The room of ``calib`` that a dotted name lies in; None for the package itself or something else."""
    parts = name.split(".")
    return parts[2] if parts[:2] == ["mavcal", "calib"] and len(parts) > 2 and parts[2] in ROOMS else None


def layer(of: str) -> int:
    return next(i for i, rooms in enumerate(LAYERS) if of in rooms)


def climbs(name: str, source: str) -> set[str]:
    """Imports of a module of ``calib`` that lie above its own layer."""
    own = name.split(".")[2]
    height = -1 if own == "__init__" else layer(own)
    return {i for i in imports(name, source) if (other := room(i)) is not None and layer(other) > height}


def impurities(name: str, source: str) -> set[str]:
    """Imports that a module of ``calib`` must not have: clocks, sockets, environment, or what is not declared."""
    allowed = PURE | STANDARD
    own = ("mavcal.calib.", "mavcal.calib")
    return {
        i
        for i in imports(name, source)
        if (i.split(".")[0] not in allowed and not i.startswith(own)) or i.startswith("pymavlink.mavutil")
    }


def strangers(name: str, source: str) -> set[str]:
    """Imports of the simulated vehicle that would make it read the facts with our eyes."""
    return {
        i
        for i in imports(name, source)
        if (i.split(".")[0] == "mavcal" and not i.startswith("mavcal.service.simvehicle"))
        or i.startswith("pymavlink.mavutil")
    }


def offenders(package: str, rule: Callable[[str, str], set[str]]) -> dict[str, set[str]]:
    return {name: bad for name, source in modules(package).items() if (bad := rule(name, source))}


def test_every_room_of_calib_has_a_layer():
    assert {name.split(".")[2] for name in modules("calib")} - {"__init__"} <= ROOMS


def test_a_room_of_calib_imports_only_its_own_layer_and_below():
    assert offenders("calib", climbs) == {}


def test_calib_is_pure():
    assert not FORBIDDEN & (PURE | STANDARD)
    assert offenders("calib", impurities) == {}


def test_calib_does_not_print():
    def prints(_name: str, source: str) -> set[str]:
        calls = [node.func for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call)]
        return {f.id for f in calls if isinstance(f, ast.Name) and f.id in {"print", "input"}}

    assert offenders("calib", prints) == {}


def test_the_simulated_vehicle_reads_the_facts_for_itself():
    assert offenders("service/simvehicle", strangers) == {}


@pytest.mark.parametrize(
    ("rule", "name", "source"),
    [
        (climbs, "mavcal.calib.triad", "from mavcal.calib.report import fit_to_json"),
        (climbs, "mavcal.calib.firmware.px4.parameters", "from ...logs import tlog"),
        (climbs, "mavcal.calib.__init__", "import mavcal.calib.errors"),
        (impurities, "mavcal.calib.accel.poses", "import time"),
        (impurities, "mavcal.calib.wire.frames", "from mavcal.service.errors import LinkError"),
        (impurities, "mavcal.calib.logs.tlog", "from pymavlink.mavutil import mavlink_connection"),
        (strangers, "mavcal.service.simvehicle.vehicle", "from mavcal.calib.wire import decode"),
        (strangers, "mavcal.service.simvehicle.vehicle", "from ..link import endpoints"),
    ],
)
def test_the_rules_see_a_violation(rule, name, source):
    assert rule(name, source)
