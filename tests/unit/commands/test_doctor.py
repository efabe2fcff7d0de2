from __future__ import annotations

import datetime
import json
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from mavcal.calib.errors import InvalidInputError
from mavcal.service.commands import doctor
from mavcal.service.commands.doctor import LEAST_FREE_BYTES, DoctorFinding, command


def test_a_folder_that_is_not_there_yet_is_judged_by_the_one_it_will_be_in(tmp_path):
    found = doctor._data_dir(tmp_path / "a" / "b")
    assert (found.verdict, found.text.split(",")[0]) == ("pass", str(tmp_path / "a" / "b"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("free", "verdict"), [(LEAST_FREE_BYTES + 1, "pass"), (LEAST_FREE_BYTES, "warn")])
def test_little_room_is_a_warning(tmp_path, monkeypatch, free, verdict):
    monkeypatch.setattr(doctor.shutil, "disk_usage", lambda _: SimpleNamespace(free=free))
    assert doctor._data_dir(tmp_path).verdict == verdict


def test_a_folder_that_nobody_can_write_into_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(doctor.os, "access", lambda *_: False)
    found = doctor._data_dir(tmp_path)
    assert (found.id, found.verdict) == ("data-dir", "fail")
    assert str(tmp_path) in found.text
    assert "set data_dir" in found.text


def test_a_disk_that_is_full_fails(tmp_path, monkeypatch):
    def full(**_):
        raise OSError(28, "full")

    monkeypatch.setattr(doctor.tempfile, "TemporaryFile", full)
    found = doctor._data_dir(tmp_path)
    assert found.verdict == "fail"
    assert f"{tmp_path}: full" in found.text


def test_a_library_that_is_missing_fails_and_the_others_have_their_versions(monkeypatch):
    def version(name):
        if name == "scipy":
            raise doctor.importlib.metadata.PackageNotFoundError(name)
        return "1.2.3"

    monkeypatch.setattr(doctor.importlib.metadata, "version", version)
    found = {one.id: one.verdict for one in doctor._packages()}
    assert {name for name, verdict in found.items() if verdict == "fail"} == {"scipy"}
    assert len(found) == len(doctor.DISTRIBUTIONS)


@pytest.mark.parametrize(("version", "verdict"), [((3, 10, 9), "fail"), ((3, 11, 0), "pass"), ((3, 13), "pass")])
def test_an_old_python_fails(monkeypatch, version, verdict):
    monkeypatch.setattr(doctor.sys, "version_info", version)
    assert doctor._python().verdict == verdict


@pytest.mark.parametrize(
    ("ports", "opened", "verdict", "said"),
    [
        ([], True, "pass", "no serial port here"),
        (["/dev/ttyACM0", "/dev/ttyACM1"], True, "pass", "/dev/ttyACM0, /dev/ttyACM1"),
        (["/dev/ttyACM0"], False, "warn", "/dev/ttyACM0 may not be opened: join the group dialout"),
    ],
)
def test_a_serial_port_that_may_not_be_opened_is_a_warning(monkeypatch, ports, opened, verdict, said):
    from serial.tools import list_ports

    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(device=port) for port in ports])
    monkeypatch.setattr(doctor.os, "access", lambda *_: opened)
    assert doctor._serial() == DoctorFinding("serial", verdict, said)


@pytest.fixture
def middle_of_2026(monkeypatch):
    """It is the second of July: 182 days of the year have gone."""
    now = datetime.datetime(2026, 7, 2, 12, 0, tzinfo=datetime.UTC)
    clock = SimpleNamespace(now=lambda tz: now.astimezone(tz))
    monkeypatch.setattr(doctor, "datetime", SimpleNamespace(datetime=clock, UTC=datetime.UTC))


@pytest.mark.usefixtures("middle_of_2026")
@pytest.mark.parametrize(("valid", "verdict", "word"), [(True, "pass", "covers"), (False, "warn", "ended before")])
def test_a_model_of_the_field_that_has_ended_is_a_warning(monkeypatch, valid, verdict, word):
    asked = []

    def field(latitude, longitude, altitude, year):
        asked.append(year)
        return SimpleNamespace(valid=valid)

    monkeypatch.setattr("mavcal.calib.earth.earth_field", field)
    found = doctor._magnetic_model()
    assert (found.verdict, word in found.text) == (verdict, True)
    assert asked == [pytest.approx(2026 + 182 / 365.25)]
    assert found.text.endswith("2026.50")


@pytest.mark.usefixtures("middle_of_2026")
def test_a_model_that_cannot_be_read_fails(monkeypatch):
    def broken(*_):
        raise InvalidInputError("no coefficients")

    monkeypatch.setattr("mavcal.calib.earth.earth_field", broken)
    assert doctor._magnetic_model() == DoctorFinding("magnetic-model", "fail", "no coefficients")


@pytest.mark.parametrize(("verdict", "code"), [("pass", 0), ("warn", 0), ("fail", 1)])
def test_only_what_fails_makes_the_exit_code(monkeypatch, verdict, code):
    found = DoctorFinding("port", verdict, "so")
    for name in ("_python", "_serial", "_magnetic_model"):
        monkeypatch.setattr(doctor, name, lambda: DoctorFinding("x", "pass", "fine"))
    monkeypatch.setattr(doctor, "_packages", list)
    monkeypatch.setattr(doctor, "_data_dir", lambda _: DoctorFinding("data-dir", "pass", "fine"))
    monkeypatch.setattr(doctor, "_port", lambda _: found)
    monkeypatch.setattr(doctor, "load_settings", lambda: SimpleNamespace(data_dir=None))
    said = CliRunner().invoke(command, [], standalone_mode=False)
    assert said.return_value == code
    assert f"{verdict}  port            so" in said.stdout
    told = json.loads(CliRunner().invoke(command, ["--json"], standalone_mode=False).stdout)
    assert {"id": "port", "verdict": verdict, "text": "so"} in told["findings"]
