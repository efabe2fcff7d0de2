from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from mavcal.service.settings import Settings, is_loopback, settings_table

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
