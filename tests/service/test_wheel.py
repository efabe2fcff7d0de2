"""The wheel in a fresh environment, beside strangers that own the names ``calib`` and ``service``."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from mavcal.calib import __version__
from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
STRANGERS = ("calib", "client", "service")

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    words = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder), str(ROOT))
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def fresh(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment with the wheel and both strangers; what mavcal depends on is borrowed from this one."""
    folder = tmp_path_factory.mktemp("fresh") / "env"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(folder)], check=True)
    place = folder / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    (place / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")  # its own .pth files are not read
    words = ("install", "--quiet", "--no-index", "--no-deps", "--no-compile", "--force-reinstall", str(wheel))
    into = ("--python", str(folder / "bin" / "python"))
    subprocess.run([sys.executable, "-m", "pip", *into, *words], check=True, capture_output=True)
    for name in STRANGERS:
        (place / name).mkdir()
        (place / name / "__init__.py").write_text("raise ImportError('a stranger of this name')\n")
        (place / name / "errors.py").write_text("")
    return folder


def run(fresh: Path, *words: str, seconds: float = 60.0) -> subprocess.CompletedProcess[str]:
    empty = fresh / "empty"
    empty.mkdir(exist_ok=True)
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))}
    return subprocess.run(
        [str(fresh / "bin" / "mavcal"), *words],
        cwd=empty, env=environment, capture_output=True, text=True, check=False, timeout=scaled(seconds),
    )  # fmt: skip


def test_the_wheel_brings_one_name_and_the_panel(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {"mavcal", f"mavcal-{__version__}.dist-info"}
    assert {
        "mavcal/calib/triad.py",
        "mavcal/client/waiting.py",
        "mavcal/service/cli.py",
        "mavcal/service/_web/index.html",
    } <= set(names)
    assert {"mavcal/calib/gap_report/templates/report.html", "mavcal/service/templates/export.html"} <= set(names)


@pytest.mark.long
def test_strangers_of_the_old_names_change_nothing(fresh: Path) -> None:
    done = run(fresh, "--version")
    assert done.returncode == 0, done.stderr
    assert __version__ in done.stdout
    where = subprocess.run(
        [str(fresh / "bin" / "python"), "-c", "import mavcal.service as s; print(s.__file__)"],
        cwd=fresh, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    assert where.startswith(str(fresh)), where


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_demo_runs_from_an_empty_directory(fresh: Path) -> None:
    done = run(fresh, "demo", "--speed", "12", "--seed", "11", seconds=800.0)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
