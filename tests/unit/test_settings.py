from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from mavcal.service.settings import ApiKey, Settings, default_data_dir, is_loopback
from scripts.settings import settings_table

ROOT = Path(__file__).resolve().parents[2]


def test_an_unknown_setting_is_refused():
    with pytest.raises(ValidationError, match="prot"):
        Settings(prot=1)


def test_the_environment_reaches_nested_settings(monkeypatch):
    monkeypatch.setenv("MAVCAL_MAVLINK__SYSTEM", "77")
    assert Settings().mavlink.system == 77


def test_a_keyword_wins_over_the_environment(monkeypatch):
    monkeypatch.setenv("MAVCAL_PORT", "1000")
    assert Settings(port=2000).port == 2000


def test_component_zero_is_no_source():
    with pytest.raises(ValidationError, match="component"):
        Settings(mavlink={"component": 0})


def test_a_secret_does_not_show():
    settings = Settings(mavlink={"signing_key": "ab" * 32})
    assert "ab" * 32 not in settings.model_dump_json() + repr(settings)


@pytest.mark.parametrize(
    ("host", "expected"),
    [("127.0.0.1", True), ("::1", True), ("localhost", True), ("0.0.0.0", False), ("10.0.0.1", False), ("x", False)],
)
def test_loopback(host, expected):
    assert is_loopback(host) is expected


def test_the_documentation_lists_every_setting():
    assert settings_table() in (ROOT / "docs" / "settings.md").read_text()


DIGEST = "0a" * 32


@pytest.mark.parametrize(
    ("path", "least", "most"),
    [
        ("port", 0, 65535),
        ("mavlink.system", 1, 255),
        ("mavlink.component", 1, 255),
        ("mavlink.yield_s", 10.0, None),
        ("limits.file_memory_bytes", 2**28, None),
        ("limits.file_cpu_s", 1.0, None),
        ("limits.file_processes", 1, 64),
        ("retention.tlog_bytes", 4096, None),
        ("retention.recordings_bytes", 0, None),
        ("fleet.lease_s", 2.0, 300.0),
    ],
)
def test_a_number_has_bounds_that_belong_to_it(path, least, most):
    def made(value):
        for name in reversed(path.split(".")):
            value = {name: value}
        found = Settings(**value)
        for name in path.split("."):
            found = getattr(found, name)
        return found

    step = 1 if isinstance(least, int) else 0.001
    assert made(least) == least
    with pytest.raises(ValidationError, match=path.split(".")[-1]):
        made(least - step)
    if most is not None:
        assert made(most) == most
        with pytest.raises(ValidationError, match=path.split(".")[-1]):
            made(most + step)


@pytest.mark.parametrize(
    "name", ["body_window_s", "head_s", "gap_s", "file_wall_s", "upload_bytes", "streams", "heads"]
)
def test_a_limit_of_nothing_is_refused(name):
    with pytest.raises(ValidationError, match=name):
        Settings(limits={name: 0})


@pytest.mark.parametrize("name", ["recordings_days", "tlogs_days", "tlog_hours", "events_days", "keys_days", "events"])
def test_what_is_forgotten_at_once_is_no_retention(name):
    with pytest.raises(ValidationError, match=name):
        Settings(retention={name: 0})


def test_nothing_uploaded_or_recorded_is_forgotten_unless_it_is_asked_for():
    kept = Settings().retention
    assert (kept.recordings_days, kept.recordings_bytes, kept.tlogs_days, kept.tlogs_bytes) == (None,) * 4


def test_paths_are_absolute_and_the_home_folder_is_meant(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    settings = Settings(data_dir="~/state", uploads_dir="up", links={"folders": ["~/logs"]})
    assert (settings.data_dir, settings.uploads) == (tmp_path / "state", tmp_path / "up")
    assert settings.links.folders == (tmp_path / "logs",)
    assert Settings(data_dir="x").uploads == tmp_path / "x" / "recordings"


@pytest.mark.parametrize(
    ("platform", "env", "place"),
    [
        ("linux", {"XDG_STATE_HOME": "/var/state"}, "/var/state/mavcal"),
        ("linux", {}, "/home/pilot/.local/state/mavcal"),
        ("darwin", {"XDG_STATE_HOME": "/var/state"}, "/home/pilot/Library/Application Support/mavcal"),
        ("win32", {"LOCALAPPDATA": "/appdata"}, "/appdata/mavcal"),
    ],
)
def test_state_lies_where_the_platform_has_it(monkeypatch, platform, env, place):
    for name in ("XDG_STATE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/pilot", **env}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("mavcal.service.settings.sys.platform", platform)
    assert default_data_dir().as_posix() == place


def test_the_file_is_read_where_neither_keyword_nor_environment_says_otherwise(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mavcal.toml").write_text("port = 1\nread_only = true\n[mavlink]\nsystem = 11\nyield_s = 20.0\n")
    monkeypatch.setenv("MAVCAL_PORT", "2")
    monkeypatch.setenv("MAVCAL_MAVLINK__SYSTEM", "22")
    settings = Settings()
    assert (settings.port, settings.read_only) == (2, True)
    assert (settings.mavlink.system, settings.mavlink.yield_s) == (22, 20.0)
    assert Settings(port=3).port == 3
    (tmp_path / "mavcal.toml").write_text("prot = 1\n")
    with pytest.raises(ValidationError, match="prot"):
        Settings()


@pytest.mark.parametrize(
    ("key", "why"),
    [
        ({"name": "", "sha256": DIGEST}, "name"),
        ({"name": "a", "sha256": "secret"}, "sha256"),
        ({"name": "a", "sha256": DIGEST.upper()}, "sha256"),
        ({"name": "a", "sha256": DIGEST, "scopes": ["fly"]}, "scopes"),
        ({"name": "a", "sha256": DIGEST, "tags": ["two words"]}, "tags"),
        ({"name": "a", "sha256": DIGEST, "tags": ["x" * 41]}, "tags"),
        ({"name": "a", "sha256": DIGEST, "scopes": ["admin", "read"], "tags": ["boats"]}, "sees every vehicle"),
    ],
)
def test_a_key_that_would_not_protect_is_refused(key, why):
    with pytest.raises(ValidationError, match=why):
        ApiKey(**key)


def test_a_key_may_read_unless_more_is_given():
    assert ApiKey(name="a", sha256=DIGEST).scopes == {"read"}
    assert ApiKey(name="a", sha256=DIGEST, scopes=["operate"], tags=["boats", "x" * 40]).tags == {"boats", "x" * 40}
    assert ApiKey(name="a", sha256=DIGEST, scopes=["admin"]).tags == frozenset()


@pytest.mark.parametrize("key", ["ab" * 31, "ab" * 33, "zz" * 32, "ab" * 32 + "\n", ""])
def test_a_signing_key_has_64_digits(key):
    with pytest.raises(ValidationError, match="64 hexadecimal digits"):
        Settings(mavlink={"signing_key": key})
    with pytest.raises(ValidationError, match="64 hexadecimal digits"):
        Settings(mavlink={"signing_keys": {"boat": key}})


@pytest.mark.parametrize("name", ["", "-x", "a b", "x" * 65, "../x"])
def test_a_signing_key_has_a_name_that_an_endpoint_can_carry(name):
    with pytest.raises(ValidationError):
        Settings(mavlink={"signing_keys": {name: DIGEST}})


def test_inside_blueos_its_pages_may_address_and_frame_the_service():
    plain, inside = Settings(allowed_hosts=("boat.local",)), Settings(allowed_hosts=("boat.local",), blueos=True)
    assert (plain.hosts, plain.blueos_origins, plain.ancestors) == (("boat.local",), (), ("'self'",))
    assert inside.hosts[0] == "boat.local"
    assert {"blueos.local", "192.168.2.2"} <= set(inside.hosts)
    assert set(inside.ancestors) == {"'self'", *inside.blueos_origins}
    assert inside.blueos_origins == tuple(f"http://{host}" for host in inside.hosts[1:])


@pytest.mark.parametrize("url", ["harbour:8765", "ftp://harbour/", "http://", "http:// x/"])
def test_the_address_of_an_instance_is_one_that_a_client_can_open(url):
    assert Settings(fleet={"url": "https://harbour:8765/mavcal/"}).fleet.url == "https://harbour:8765/mavcal/"
    with pytest.raises(ValidationError, match="url"):
        Settings(fleet={"url": url})


def test_settings_do_not_change_while_the_service_runs():
    settings = Settings()
    with pytest.raises(ValidationError, match="frozen"):
        settings.port = 1
    with pytest.raises(ValidationError, match="frozen"):
        settings.mavlink.system = 1
