"""Who may import whom: layers of ``calib``, ``service`` above them, and two enclosures with one door each."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

LAYERS = (
    {"errors"},
    {
        "wire",
        "recording",
        "triad",
        "fit",
        "plots",
        "summary",
        "geometry",
        "attitude",
        "tilt",
        "posture",
        "c_array",
        "conventions",
        "option",
        "pages",
        "drawing",
        "converter",
    },
    {"earth", "stats"},
    {"noise", "accel", "gyro", "thermal", "imu", "mag"},
    {"simulate", "firmware", "converted"},
    {"logs"},
    {"procedures", "gap", "flight", "health", "preflight", "fleet", "blind", "withheld_check"},
    {"report", "methods", "gap_report", "review", "library"},
)
"""Rooms of ``calib``, lowest first; a room imports its own layer and the ones below, never in a circle."""

ROOMS = set().union(*LAYERS)

GAP_LAYERS = (
    {"remembered"},
    {"schema", "likelihood"},
    {"problem", "progress"},
    {"reference"},
    {"effects"},
    {"model", "export"},
    {"search"},
    {"heldout", "worth"},
    {"unknown"},
    {"telling"},
    {"companion"},
    {"diagnose"},
    {"verify"},
)
"""Rooms of ``calib/gap``, lowest first; a room imports the layers below its own, and no other room of its own layer."""

PURE = {"numpy", "scipy", "pygeomag", "pyulog", "pymavlink", "fastcrc", "jinja2", "markupsafe", "cattrs", "matplotlib"}
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
    *("zipfile", "zlib", "importlib", "numbers", "unicodedata", "contextvars"),
}


@cache
def modules(package: str) -> dict[str, str]:
    """Dotted name and source of every module below `package`."""
    paths = sorted((ROOT / package).rglob("*.py"))
    return {
        ".".join(("mavcal", *p.relative_to(ROOT).with_suffix("").parts)): p.read_text(encoding="utf-8") for p in paths
    }


@cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    return tuple(
        node
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Import | ast.ImportFrom | ast.Constant | ast.Call | ast.Attribute)
    )


@cache
def imports(name: str, source: str) -> frozenset[str]:
    """Everything that a module imports, relative imports resolved; ``from a import b`` counts as ``a.b``."""
    package = name.split(".")
    found = set()
    for node in nodes(source):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return frozenset(found)


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


def gap_room(name: str) -> str | None:
    """The room of ``calib/gap`` that a dotted name lies in; None for its face or something else."""
    parts = name.split(".")
    return parts[3] if parts[:3] == ["mavcal", "calib", "gap"] and len(parts) > 3 else None


def gap_climbs(name: str, source: str) -> set[str]:
    """Imports of a module of ``calib/gap`` that lie in another room, and not below its own layer."""
    heights = {one: i for i, rooms in enumerate(GAP_LAYERS) for one in rooms}
    own = gap_room(name)
    if own not in heights:
        return set()
    others = {i: gap_room(i) for i in imports(name, source) if gap_room(i) not in (None, own)}
    return {i for i, other in others.items() if heights.get(str(other), len(GAP_LAYERS)) >= heights[own]}


def impurities(name: str, source: str) -> set[str]:
    """Imports that a module of ``calib`` must not have: clocks, sockets, environment, or what is not declared."""
    allowed = PURE | STANDARD
    own = ("mavcal.calib.", "mavcal.calib")
    return {
        i
        for i in imports(name, source)
        if (i.split(".")[0] not in allowed and not i.startswith(own)) or i.startswith("pymavlink.mavutil")
    }


@dataclass(frozen=True)
class Enclosure:
    """A package that is entered by one module, and itself goes out only for what is listed."""

    package: str
    door: str
    may: frozenset[str] = frozenset()
    """Modules of the project that the package may import."""

    def inside(self, name: str) -> bool:
        return f"{name}.".startswith(f"{self.package}.")

    def intruding(self, name: str, source: str) -> set[str]:
        """Imports of a module outside that pass by the door, or that the door does not offer; paths in texts too."""
        if self.inside(name) or name == self.door:
            return set()
        offered = {self.door, *(f"{self.door}.{each}" for each in importlib.import_module(self.door).__all__)}
        texts = [node.value for node in nodes(source) if isinstance(node, ast.Constant)]
        named = {text for text in texts if isinstance(text, str) and re.fullmatch(r"[\w.]+", text)}
        ours = (f"{self.package}.", f"{self.door}.")
        return {i for i in imports(name, source) | named if f"{i}.".startswith(ours)} - offered

    def straying(self, name: str, source: str) -> set[str]:
        """Imports of a module inside that lie in the project and are not listed."""
        if not self.inside(name):
            return set()
        ours = {i for i in imports(name, source) if i.split(".")[0] == "mavcal" and not self.inside(i)}
        return {i for i in ours if not any(f"{i}.".startswith(f"{each}.") for each in self.may)}


SIMVEHICLE = Enclosure("mavcal.service.simvehicle", "mavcal.service.simvehicle")
"""It reads the facts for itself: nothing of ours is on its list."""
BLIND = Enclosure(
    "mavcal.calib.blind", "mavcal.calib.withheld_check", frozenset({"mavcal.calib.recording", "mavcal.calib.errors"})
)
"""It shares with the diagnosis only the form of a recording."""


def outsiders(name: str, source: str) -> set[str]:
    """Imports of the client that would bring the service, or what calibrates, to whoever only asks."""
    return {i for i in imports(name, source) if i.split(".")[0] == "mavcal" and not i.startswith("mavcal.client")}


def half_made(_name: str, source: str) -> set[str]:
    """Packages of scipy two levels down, reached as attributes: half-made while another thread imports one."""
    chains = {ast.unparse(node) for node in nodes(source) if isinstance(node, ast.Attribute)}
    deep = {chain for chain in chains if re.fullmatch(r"scipy(\.\w+){2}", chain)}
    return {chain for chain in deep if importlib.util.find_spec(chain) is not None}


def offenders(package: str, rule: Callable[[str, str], set[str]]) -> dict[str, set[str]]:
    return {name: bad for name, source in modules(package).items() if (bad := rule(name, source))}


def test_every_room_of_calib_has_a_layer():
    assert {name.split(".")[2] for name in modules("calib")} - {"__init__"} <= ROOMS


def test_a_room_of_calib_imports_only_its_own_layer_and_below():
    assert offenders("calib", climbs) == {}


def test_every_room_of_the_gap_has_a_layer():
    found = {gap_room(name) for name in modules("calib/gap")} - {"__init__"}
    assert found == set().union(*GAP_LAYERS)
    assert sum(map(len, GAP_LAYERS)) == len(found)  # each has one layer


def test_a_room_of_the_gap_imports_only_the_layers_below_its_own():
    assert offenders("calib/gap", gap_climbs) == {}


def test_calib_is_pure():
    assert not FORBIDDEN & (PURE | STANDARD)
    assert offenders("calib", impurities) == {}


@pytest.mark.parametrize("package", ["calib", "service"])
def test_a_package_is_whole_when_it_is_used(package):
    assert offenders(package, half_made) == {}


def test_calib_does_not_print():
    def prints(_name: str, source: str) -> set[str]:
        calls = [node.func for node in nodes(source) if isinstance(node, ast.Call)]
        return {f.id for f in calls if isinstance(f, ast.Name) and f.id in {"print", "input"}}

    assert offenders("calib", prints) == {}


@pytest.mark.parametrize("enclosure", [SIMVEHICLE, BLIND], ids=lambda enclosure: enclosure.package)
def test_an_enclosure_has_one_door(enclosure):
    for package in ("calib", "service", "bench"):
        assert offenders(package, enclosure.intruding) == {}
        assert offenders(package, enclosure.straying) == {}


def test_the_simulated_vehicle_frames_its_messages_itself():
    def through_utilities(name: str, source: str) -> set[str]:
        return {i for i in imports(name, source) if i.startswith("pymavlink.mavutil")}

    assert offenders("service/simvehicle", through_utilities) == {}


def test_the_client_stands_alone():
    assert offenders("client", outsiders) == {}


@pytest.mark.parametrize(
    ("rule", "name", "source"),
    [
        (climbs, "mavcal.calib.triad", "from mavcal.calib.report import to_json"),
        (climbs, "mavcal.calib.firmware.px4.parameters", "from ...logs import tlog"),
        (climbs, "mavcal.calib.__init__", "import mavcal.calib.errors"),
        (gap_climbs, "mavcal.calib.gap.model.joint", "from mavcal.calib.gap.search.contest import Contest"),
        (gap_climbs, "mavcal.calib.gap.reference.build", "from mavcal.calib.gap.effects import catalogue"),
        (gap_climbs, "mavcal.calib.gap.heldout.gates", "from mavcal.calib.gap.worth.attribution import attributed"),
        (gap_climbs, "mavcal.calib.gap.diagnose", "from ..gap import verify"),
        (impurities, "mavcal.calib.accel.poses", "import time"),
        (impurities, "mavcal.calib.wire.frames", "from mavcal.service.errors import LinkError"),
        (impurities, "mavcal.calib.logs.tlog", "from pymavlink.mavutil import mavlink_connection"),
        (SIMVEHICLE.straying, "mavcal.service.simvehicle.vehicle", "from mavcal.calib.wire import decode"),
        (SIMVEHICLE.straying, "mavcal.service.simvehicle.vehicle", "from ..link import endpoints"),
        (SIMVEHICLE.intruding, "mavcal.service.demo.run", "from mavcal.service.simvehicle.client import start"),
        (SIMVEHICLE.intruding, "mavcal.service.demo.run", "from ..simvehicle import server"),
        (SIMVEHICLE.intruding, "mavcal.service.demo.run", "import_module('mavcal.service.simvehicle.server')"),
        (BLIND.straying, "mavcal.calib.blind.cases", "from mavcal.calib.gap.diagnose import diagnose"),
        (BLIND.intruding, "mavcal.calib.gap.diagnose", "from ..blind import cases"),
        (BLIND.intruding, "mavcal.service.commands.gap", "from mavcal.calib.withheld_check import nothing"),
        (half_made, "mavcal.calib.tilt", "import scipy\nturn = scipy.spatial.transform.Rotation"),
        (outsiders, "mavcal.client.models", "from mavcal.service.jobs.states import JobState"),
    ],
)
def test_the_rules_see_a_violation(rule, name, source):
    assert rule(name, source)
