"""Asking for help loads next to nothing: the machine of a drone starts `mavcal` for every question."""

from __future__ import annotations

import subprocess
import sys

import pytest

LISTING = """
import sys
from mavcal.service.cli import main
try:
    main(sys.argv[1:])
except SystemExit as ended:
    assert not ended.code, ended.code
print(*sorted(name for name in sys.modules if "." not in name or name.startswith("mavcal")), file=sys.stderr)
"""


def loaded(*arguments: str) -> tuple[str, set[str]]:
    """What the command line prints, and the modules that it has loaded by then."""
    done = subprocess.run(
        [sys.executable, "-c", LISTING, *arguments], capture_output=True, text=True, check=True, timeout=60
    )
    return done.stdout, set(done.stderr.split())


@pytest.mark.parametrize("arguments", [["--help"], ["fit", "--help"], ["--version"]], ids=" ".join)
def test_help_loads_no_library_of_numbers_and_no_server(arguments):
    said, modules = loaded(*arguments)
    assert "mavcal" in said.lower() or "method" in said
    assert "mavcal.service.cli" in modules
    heavy = {"numpy", "scipy", "pymavlink", "fastapi", "pydantic", "uvicorn", "jinja2", "cattrs"}
    heavy |= {"httpx", "mavcal.client"}
    assert not heavy & modules


def test_the_help_of_fit_names_every_method_and_its_purpose():
    said, _ = loaded("fit", "--help")
    for text in ("gyro-rest", "Gyroscope offset at rest", "mag-flight", "allan"):
        assert text in said


def test_a_service_starts_without_what_only_fits_and_diagnoses_need():
    listing = "import sys, mavcal.service.app; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", listing], capture_output=True, text=True, check=True, timeout=60)
    loaded = set(done.stdout.split())
    assert "mavcal.service.core" in loaded
    assert not {"mavcal.calib.gap.diagnose", "mavcal.calib.blind", "mavcal.calib.mag.flight"} & loaded
    heavy = {"special", "linalg", "spatial", "ndimage", "fft", "stats", "signal"}  # a third of its memory
    assert not {f"scipy.{name}" for name in heavy} & loaded


def test_planning_loads_no_method_for_its_help():
    said, modules = loaded("plan", "--help")
    assert "mag-ellipsoid" in said
    assert not {"scipy", "fastapi", "mavcal.calib.methods.mag"} & modules
