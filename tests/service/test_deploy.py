"""`deploy/`: the unit and the install script, run from an empty folder; the image, as far as this machine can."""

from __future__ import annotations

import fnmatch
import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import httpx
import pytest

from mavcal.service.api.security import digest
from mavcal.service.settings import Settings
from scripts.settings import settings_table
from tests.patience import patience, scaled

from .deployed import (
    DEPLOY,
    ROOT,
    UNIT,
    Installed,
    Instruction,
    Running,
    clean_environment,
    environment_of,
    image,
    seconds_of,
    started,
    unit,
)
from .test_api_recordings import sphere_csv

DOCS = (ROOT / "docs" / "deploy.md").read_text()
pytestmark = pytest.mark.timeout(300)


# --- the unit

HARDENED = {
    "DynamicUser": "yes",
    "ProtectSystem": "strict",
    "ProtectHome": "yes",
    "PrivateTmp": "yes",
    "NoNewPrivileges": "yes",
    "CapabilityBoundingSet": "",
    "RestrictAddressFamilies": "AF_INET AF_INET6 AF_UNIX",
    "MemoryDenyWriteExecute": "yes",
    "DevicePolicy": "closed",
    "OOMPolicy": "continue",
    "KillMode": "mixed",
    "Restart": "on-failure",
    "StateDirectory": "mavcal",
}


def test_the_unit_keeps_its_limits() -> None:
    told = unit()
    assert {name: told.get(name) for name in HARDENED} == {name: [value] for name, value in HARDENED.items()}
    assert "MemoryMax" in told
    assert {"char-ttyACM rw", "char-ttyUSB rw"} <= set(told["DeviceAllow"])
    assert "WatchdogSec" not in told  # the service sends no keep-alive


def analyzer() -> str:
    found = shutil.which("systemd-analyze")
    if found is None:
        pytest.skip("systemd-analyze is not here (Debian: package systemd)")
    return found


def test_systemd_finds_no_fault_in_the_unit(tmp_path: Path) -> None:
    here = tmp_path / UNIT.name
    (program, *_) = unit()["ExecStart"][0].split()
    here.write_text(UNIT.read_text().replace(program, sys.executable))  # it looks for the program
    done = subprocess.run([analyzer(), "verify", str(here)], capture_output=True, text=True, check=False)
    assert "mavcal" not in done.stderr, done.stderr
    assert done.returncode == 0, done.stderr


def test_the_documentation_states_the_exposure_of_the_unit() -> None:
    version = subprocess.run([analyzer(), "--version"], capture_output=True, text=True, check=True).stdout.split()[1]
    command = [analyzer(), "security", "--offline=true", "--no-pager", str(UNIT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    found = re.search(r"Overall exposure level for mavcal.service: ([\d.]+)", done.stdout)
    assert found is not None, done.stderr
    stated = re.search(r"exposure level of ([\d.]+) by systemd (\d+)", DOCS)
    assert stated is not None
    if version != stated[2]:
        pytest.skip(f"the documentation states the level by systemd {stated[2]}; this is {version}: {found[1]}")
    assert found[1] == stated[1]


def test_every_line_of_the_example_is_a_valid_setting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    example = tmp_path / "mavcal.env"
    assert environment_of(DEPLOY / "mavcal.env") == {}
    example.write_text(re.sub("^#MAVCAL", "MAVCAL", (DEPLOY / "mavcal.env").read_text(), flags=re.MULTILINE))
    given = environment_of(example)
    assert len(given) > 5
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert {name.split("__")[0].removeprefix("MAVCAL_").lower() for name in given} <= settings.model_fields_set
    assert settings.connect[0].startswith("serial:")


def test_the_documentation_names_only_settings_that_exist() -> None:
    names = set(re.findall(r"MAVCAL_[A-Z_]+", DOCS + (DEPLOY / "Dockerfile").read_text() + UNIT.read_text()))
    assert {name for name in names if f"`{name}`" not in settings_table()} == set()


# --- installed


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Made from what the Dockerfile copies, and from nothing else."""
    folder = tmp_path_factory.mktemp("context")
    for source in copied():
        path = ROOT / source
        if path.is_dir():
            shutil.copytree(path, folder / source, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            (folder / source).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, folder / source)
    words = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", str(folder / "made"), str(folder))
    subprocess.run([sys.executable, "-m", "pip", *words], check=True, capture_output=True)
    (made,) = (folder / "made").glob("*.whl")
    return made


def install(wheel: Path, folder: Path) -> Installed:
    """`deploy/install` without a package index; what mavcal depends on is borrowed from this environment."""
    environment = {**os.environ, "DESTDIR": str(folder), "PYTHON": sys.executable}
    command = [str(DEPLOY / "install"), str(wheel)]
    without = {"PIP_NO_DEPS": "1", "PIP_NO_INDEX": "1", "PIP_NO_COMPILE": "1"}  # most modules are not asked for here
    subprocess.run(command, env=environment | without, check=True, capture_output=True)
    installed = Installed(folder)
    (place,) = installed.at("/opt/mavcal/lib").glob("python*/site-packages")
    (place / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return installed


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Installed:
    installed = install(wheel, tmp_path_factory.mktemp("installed"))
    with installed.environment_file.open("a") as file:
        file.write("MAVCAL_PORT=0\n")
    return installed


def healthy(running: Running) -> bool:
    return httpx.get(f"{running.url}/healthz", timeout=scaled(20)).json() == {"status": "ok"}


@pytest.mark.long
def test_what_is_installed_starts_as_the_unit_says_and_ends_at_sigterm(installed: Installed) -> None:
    script = installed.at(installed.unit["ExecStart"][0].split()[0])
    assert script.read_text().splitlines()[0] == "#!/opt/mavcal/bin/python"
    scripts = [path for path in script.parent.iterdir() if path.is_file() and not path.is_symlink()]
    assert [path for path in scripts if str(installed.folder).encode() in path.read_bytes()] == []
    assert installed.environment_file.stat().st_mode & 0o777 == 0o600
    with installed.started() as running:
        assert healthy(running)
        assert installed.at("/var/lib/mavcal/mavcal.sqlite3").exists()
        assert running.ended(seconds_of(installed.unit["TimeoutStopSec"][0])) == 0, running.log.read_text()


@pytest.mark.long
def test_the_unit_leaves_the_service_and_its_children_what_they_need(installed: Installed) -> None:
    analyzer()
    if not any(Path("/usr/lib").glob("**/libseccomp.so.2")):
        pytest.skip("libseccomp.so.2 is not here")
    confined = (sys.executable, str(Path(__file__).with_name("confined.py")), str(UNIT))
    with installed.started(*confined) as running, httpx.Client(base_url=running.url, timeout=60.0) as client:
        status = Path(f"/proc/{running.process.pid}/status").read_text()
        assert re.search(r"Seccomp:\s+2", status)
        uploaded = client.post("/api/v1/recordings", params={"name": "sphere.csv"}, content=sphere_csv()).json()
        order = {"method": "mag-ellipsoid", "recording": uploaded["id"]}
        job = client.post("/api/v1/fits", json=order).json()
        client.post("/api/v1/links", json={"url": "sim:ardupilot"}).raise_for_status()
        limit = patience(30.0)
        while not (job["state"] == "succeeded" and client.get("/api/v1/vehicles").json()):
            assert job["state"] not in {"failed", "cancelled"}, job
            assert not limit.over, running.log.read_text()
            job = client.get(f"/api/v1/jobs/{job['id']}").json()
        assert running.ended(seconds_of(installed.unit["TimeoutStopSec"][0])) == 0, running.log.read_text()


@pytest.mark.long
def test_an_upgrade_keeps_the_settings_and_the_environment_before(wheel: Path, tmp_path: Path) -> None:
    install(wheel, tmp_path)
    settings, scripts = tmp_path / "etc/mavcal/mavcal.env", tmp_path / "opt/mavcal/bin"
    settings.write_text("MAVCAL_PORT=1\n")
    (scripts / "before").touch()
    install(wheel, tmp_path)
    assert settings.read_text() == "MAVCAL_PORT=1\n"
    assert (tmp_path / "opt/mavcal.old/bin/before").exists()
    assert not (scripts / "before").exists()
    broken = subprocess.run(
        [str(DEPLOY / "install"), str(tmp_path / "none.whl")],
        env={**os.environ, "DESTDIR": str(tmp_path)}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert broken.returncode == 2
    assert scripts.exists()


# --- the image


def only(name: str, stage: int) -> Instruction:
    (found,) = [one for one in image() if one.name == name and one.stage == stage]
    return found


def copied() -> list[str]:
    """What the first stage takes from the checkout."""
    sources = [one.words[:-1] for one in image() if one.name == "COPY" and one.stage == 1]
    return [source.rstrip("/") for words in sources for source in words]


def image_environment() -> dict[str, str]:
    return dict(word.split("=", 1) for one in image() if one.name == "ENV" for word in one.words)


def let_in(path: str) -> bool:
    """Whether `.dockerignore` lets a path of the checkout into the build; its last matching line decides."""
    answer = True
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        pattern = line.removeprefix("!").removeprefix("**/")
        if line and line[0] != "#" and (fnmatch.fnmatch(path, pattern) or path.startswith(f"{pattern}/")):
            answer = line.startswith("!")
    return answer


def test_the_image_is_built_from_what_is_here() -> None:
    assert copied()
    assert [source for source in copied() if not ((ROOT / source).exists() and let_in(source))] == []
    assert not any(let_in(name) for name in (".git", ".venv", "tests", "bench", "docs", "mavcal.toml"))


def test_the_wheel_of_the_image_is_that_of_the_checkout(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    ours = {
        f"mavcal/{path.relative_to(ROOT).as_posix()}"
        for folder in ("calib", "client", "service")
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert ours - names == set()
    panel = [path.relative_to(ROOT / "web").as_posix() for path in (ROOT / "web").rglob("*.js")]
    assert {f"mavcal/service/_web/{name}" for name in panel} <= names


def test_the_image_runs_slim_and_not_as_root() -> None:
    last = [one for one in image() if one.stage == 2]
    assert last[0].name == "FROM"
    assert last[0].text.endswith("-slim")
    assert only("USER", 2).text not in {"root", "0"}
    assert f" {only('USER', 2).text}" in only("RUN", 2).text
    assert not re.search(r"\b(apt|gcc|pip|build-essential)\b", " ".join(one.text for one in last))
    assert only("VOLUME", 2).text == image_environment()["MAVCAL_DATA_DIR"]
    assert only("EXPOSE", 2).text == image_environment()["MAVCAL_PORT"]


def entry_point() -> list[str]:
    program, *arguments = only("ENTRYPOINT", 2).words + only("CMD", 2).words
    assert Path(program).name == "mavcal"
    return [sys.executable, "-m", "mavcal", *arguments]


@pytest.fixture
def container(tmp_path: Path) -> dict[str, str]:
    """The image's environment, with another place for its data and a port of its own."""
    return clean_environment() | image_environment() | {"MAVCAL_DATA_DIR": str(tmp_path), "MAVCAL_PORT": "0"}


def test_the_image_refuses_to_serve_strangers(container: dict[str, str]) -> None:
    done = subprocess.run(entry_point(), env=container, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "api_keys" in done.stderr


@pytest.mark.long
def test_the_image_serves_whom_its_keys_name_and_tells_its_health(container: dict[str, str], tmp_path: Path) -> None:
    keys = json.dumps([{"name": "panel", "sha256": digest("key"), "scopes": ["read"]}])
    program, *check = only("HEALTHCHECK", 2).command
    assert program == "/opt/mavcal/bin/python"
    with started(entry_point(), container | {"MAVCAL_API_KEYS": keys}, tmp_path) as running:
        asked = {**container, "MAVCAL_PORT": running.url.rpartition(":")[2]}
        assert subprocess.run([sys.executable, *check], env=asked, check=False).returncode == 0
        assert httpx.get(f"{running.url}/api/v1/jobs", timeout=scaled(20)).status_code == 401
        assert running.ended(seconds_of(unit()["TimeoutStopSec"][0])) == 0
    quiet = subprocess.run([sys.executable, *check], env=asked, capture_output=True, check=False)
    assert quiet.returncode != 0


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_image_is_built() -> None:
    docker = shutil.which("docker")
    if docker is None or subprocess.run([docker, "info"], capture_output=True, check=False).returncode:
        pytest.skip("Docker's daemon does not run here")
    command = [docker, "build", "--quiet", "--file", str(DEPLOY / "Dockerfile"), str(ROOT)]
    built = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    done = subprocess.run([docker, "run", "--rm", built, "--version"], capture_output=True, text=True, check=True)
    assert "mavcal" in done.stdout
