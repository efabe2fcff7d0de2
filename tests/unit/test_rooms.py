"""No circle ties modules of a package, nor its rooms: in ``calib`` inside a layer as little as between layers."""

from __future__ import annotations

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def sources(package: str) -> dict[str, str]:
    """Source of every module, by its dotted name below `package`; faces of folders (``__init__``) are left out."""
    base = ROOT / package
    found = {".".join(p.relative_to(base).with_suffix("").parts): p for p in sorted(base.rglob("*.py"))}
    return {name: p.read_text(encoding="utf-8") for name, p in found.items() if not name.endswith("__init__")}


def imported(source: str, package: str, names: set[str]) -> set[str]:
    """Modules of `package` and faces of its folders that a source imports, by their names below it."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(package):
            below = (node.module or "").removeprefix(package).lstrip(".")
            found |= {below} & names
            found |= {f"{below}.{alias.name}".lstrip(".") for alias in node.names} & names
    return found


def room(name: str, names: set[str]) -> str:
    """The folder of a module; a module that lies beside folders is a room of its own."""
    folder = name.rpartition(".")[0]
    beside = any(other.startswith(f"{folder}.") and "." in other.removeprefix(f"{folder}.") for other in names)
    return name if beside or not folder else folder


def rooms(modules: dict[str, str], package: str) -> dict[str, set[str]]:
    """Each room with the other rooms that it imports."""
    names = set(modules)
    found: dict[str, set[str]] = {room(name, names): set() for name in names}
    faces = {name.rpartition(".")[0] for name in names} - {""}
    for name, source in modules.items():
        own = room(name, names)
        found[own] |= {room(other, names) for other in imported(source, package, names | faces)} - {own}
    return found


def circle(of: dict[str, set[str]]) -> list[str]:
    """One circle of rooms; empty if there is none."""
    try:
        TopologicalSorter(of).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_rooms_of_calib_form_no_circle():
    found = rooms(sources("calib"), "mavcal.calib")
    assert {"mag", "imu", "firmware.compose", "firmware.proof", "firmware.names", "recording"} <= set(found)
    assert "stats" in found["mag"]
    assert "firmware.in_force" in found["firmware.compose"]
    assert circle(found) == []


def test_rooms_of_service_form_no_circle():
    found = rooms(sources("service"), "mavcal.service")
    assert {"api.models", "commands", "demo", "jobs", "link", "simvehicle", "store", "vehicle", "core"} <= set(found)
    assert "link" in found["vehicle"]
    assert "simvehicle" in found["demo"]  # through its face
    assert circle(found) == []


@pytest.mark.parametrize(
    "modules",
    [
        {"imu.weigh": "from mavcal.calib.mag.result import x", "mag.result": "from mavcal.calib.imu import weigh"},
        {
            "firmware.px4.facts": "from mavcal.calib.firmware.compose.draft import x",
            "firmware.compose.draft": "from mavcal.calib.firmware.names import x",
            "firmware.names": "from mavcal.calib.firmware.px4 import facts",
        },
        {"imu.weigh": "from mavcal.calib.mag import offered", "mag.result": "from mavcal.calib.imu.weigh import x"},
    ],
)
def test_a_circle_is_seen(modules):
    assert circle(rooms(modules, "mavcal.calib"))


@pytest.mark.parametrize("package", ["calib", "service"])
def test_no_circle_ties_modules(package):
    """An import for type checkers alone ties as well: who reads one module of a circle has to read them all."""
    modules = sources(package)
    assert len(modules) > 100
    names = set(modules)
    ties = {name: imported(source, f"mavcal.{package}", names) - {name} for name, source in modules.items()}
    assert circle(ties) == []
