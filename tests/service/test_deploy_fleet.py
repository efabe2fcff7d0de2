"""The files of `deploy/` for a fleet: as their readers read them, with settings that exist."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from mavcal.service.settings import Settings, settings_table

from .deployed import DEPLOY, ROOT

COMPOSE = DEPLOY / "compose.yaml"
KNOWN = set(re.findall(r"MAVCAL_\w+", settings_table()))


@pytest.fixture
def compose() -> dict[str, Any]:
    return dict(yaml.safe_load(COMPOSE.read_text()))


def test_compose_has_a_database_two_instances_and_a_worker(compose: dict[str, Any]) -> None:
    services = compose["services"]
    assert set(services) == {"database", "a", "b", "worker"}
    ours = [services[name] for name in ("a", "b", "worker")]
    assert len({each["environment"]["MAVCAL_DATABASE_URL"] for each in ours}) == 1
    assert len({each["environment"]["MAVCAL_UPLOADS_DIR"] for each in ours}) == 1
    assert len({each["environment"]["MAVCAL_DATA_DIR"] for each in ours}) == 3  # one process owns each
    assert {each["build"]["args"]["EXTRA"] for each in ours} == {"[fleet]"}
    assert all(each["depends_on"]["database"]["condition"] == "service_healthy" for each in ours)
    published = [port for each in services.values() for port in each.get("ports", ())]
    assert all(port.startswith("127.0.0.1:") for port in published)
    assert "ports" not in services["database"]


def test_compose_names_settings_that_exist_and_holds_no_secret(compose: dict[str, Any]) -> None:
    for each in compose["services"].values():
        names = {name for name in each.get("environment", {}) if name.startswith("MAVCAL_")}
        assert names <= KNOWN, names - KNOWN
    assert "${POSTGRES_PASSWORD:?" in COMPOSE.read_text()


def compose_command(folder: Path) -> list[str]:
    """What reads a compose file here, with the file; the older program does not know `name`. Skips if there is none."""
    if shutil.which("docker") and subprocess.run(["docker", "compose", "version"], capture_output=True).returncode == 0:
        return ["docker", "compose", "-f", str(COMPOSE)]
    if shutil.which("docker-compose"):
        copy = folder / "compose.yaml"
        copy.write_text(re.sub(r"^name:.*\n", "", COMPOSE.read_text(), flags=re.MULTILINE))
        return ["docker-compose", "--project-directory", str(DEPLOY), "-f", str(copy)]
    pytest.skip("no docker compose is here: the file was read as YAML alone")


def test_compose_itself_takes_the_file_and_demands_the_secrets(tmp_path: Path) -> None:
    command = [*compose_command(tmp_path), "config"]
    given = {"PATH": os.environ["PATH"], "POSTGRES_PASSWORD": "p", "MAVCAL_API_KEYS": "[]"}
    done = subprocess.run(command, capture_output=True, text=True, env=given, check=True)
    made = yaml.safe_load(done.stdout)["services"]
    assert made["a"]["environment"]["MAVCAL_DATABASE_URL"] == "postgresql://mavcal:p@database/mavcal"
    assert made["worker"]["command"] in ("worker", ["worker"])
    for missing in ("POSTGRES_PASSWORD", "MAVCAL_API_KEYS"):
        without = {name: value for name, value in given.items() if name != missing}
        refused = subprocess.run(command, capture_output=True, text=True, env=without, check=False)
        assert refused.returncode != 0
        assert missing in refused.stderr


def test_settings_of_the_fleet_are_settings() -> None:
    text = (DEPLOY / "fleet.env").read_text()
    lines = re.findall(r"^#?(MAVCAL_\w+)=(.+)$", text, re.MULTILINE)
    assert {name for name, _ in lines} <= KNOWN
    given = dict(lines)
    made = Settings(
        database_url=given["MAVCAL_DATABASE_URL"],
        uploads_dir=given["MAVCAL_UPLOADS_DIR"],
        fleet={"name": given["MAVCAL_FLEET__NAME"], "url": given["MAVCAL_FLEET__URL"]},
    )
    assert made.uploads == Path("/srv/mavcal/uploads")
    assert "CHANGE-ME" not in repr(made)


def test_units_are_such(tmp_path: Path) -> None:
    unit = (DEPLOY / "mavcal-worker.service").read_text()
    assert re.search(r"^ExecStart=/opt/mavcal/bin/mavcal worker$", unit, re.MULTILINE)
    for name in ("DynamicUser=yes", "ProtectSystem=strict", "NoNewPrivileges=yes", "DevicePolicy=closed"):
        assert f"\n{name}\n" in unit
    for file in ("mavcal-worker.service", "mavcal-fleet.conf"):
        for line in (DEPLOY / file).read_text().splitlines():
            assert not line or line[0] in "#[" or re.match(r"[A-Z]\w+=", line), line
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not here: the unit was read, but not verified")
    copy = tmp_path / "mavcal-worker.service"
    copy.write_text(re.sub(r"^(ExecStart=)\S+", r"\1/bin/true", unit, flags=re.MULTILINE))
    done = subprocess.run(["systemd-analyze", "verify", str(copy)], capture_output=True, text=True, check=False)
    assert "mavcal-worker" not in done.stderr, done.stderr


def test_the_page_names_the_files_that_there_are() -> None:
    page = (ROOT / "docs" / "deploy.md").read_text()
    for name in re.findall(r"deploy/([\w.-]+\w)", page):
        assert (DEPLOY / name).exists(), name
