from __future__ import annotations

import hashlib
import json

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from mavcal.service.cli import cli
from mavcal.service.commands import config
from mavcal.service.commands.config import load_settings
from mavcal.service.settings import Settings


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """The command runs in an empty folder, with nothing set."""
    monkeypatch.chdir(tmp_path)
    for name in list(config.os.environ):
        if name.upper().startswith("MAVCAL_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("MAVCAL_DATA_DIR", str(tmp_path / "data"))
    return tmp_path


def run(*arguments, text=None):
    result = CliRunner().invoke(cli, ["config", *arguments], input=text, standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    return result.stdout


def test_what_was_not_given_on_the_command_line_is_as_it_was(folder):
    (folder / "mavcal.toml").write_text("port = 1234\nread_only = true\n")
    assert load_settings(port=None).port == 1234
    assert load_settings(port=5678).port == 5678
    assert load_settings(read_only=False).read_only is False


@pytest.mark.parametrize("name", ["MAVCAL_READONLY", "mavcal_readonly", "MAVCAL_LIMIT__GAP_S"])
def test_a_mistyped_variable_does_not_pass_unnoticed(monkeypatch, name):
    monkeypatch.setenv(name, "1")
    with pytest.raises(click.UsageError, match=f"{name} in the environment is no setting"):
        load_settings()


@given(st.sampled_from(sorted(Settings.model_fields)), st.booleans(), st.sampled_from(["", "__X", "__X__Y"]))
def test_the_variable_of_every_setting_is_known(field, upper, inner):
    name = f"MAVCAL_{field}{inner}"
    assert not config._unknown_setting(name.upper() if upper else name.lower())


def test_variables_of_others_are_none_of_ours():
    assert not config._unknown_setting("HOME")
    assert not config._unknown_setting("XMAVCAL_READONLY")
    assert config._unknown_setting("MAVCAL_")


def test_every_setting_out_of_range_is_named():
    with pytest.raises(click.UsageError) as raised:
        load_settings(port=70000, log_json="perhaps")
    assert "port: " in raised.value.message
    assert "; log_json: " in raised.value.message


def test_a_setting_within_another_is_named_with_its_path(monkeypatch):
    monkeypatch.setenv("MAVCAL_LIMITS__GAP_S", "soon")
    with pytest.raises(click.UsageError, match=r"limits\.gap_s: "):
        load_settings()


def test_a_list_that_is_no_json_is_said_to_be_one(monkeypatch):
    monkeypatch.setenv("MAVCAL_CONNECT", "udpin:0.0.0.0:14550")
    with pytest.raises(click.UsageError, match="lists in the environment are JSON"):
        load_settings()


@pytest.mark.parametrize("content", [b"port = = 1", 'host = "k\u00fcche"'.encode("latin-1")])
def test_a_file_of_settings_that_is_no_toml_is_said(folder, content):
    (folder / "mavcal.toml").write_bytes(content)
    with pytest.raises(click.UsageError, match=r"mavcal\.toml is not valid TOML"):
        load_settings()


def test_settings_are_shown_flat_and_without_secrets(monkeypatch):
    monkeypatch.setenv("MAVCAL_DATABASE_URL", "postgresql://user:secret@host/name")
    shown = dict(line.split(" = ", 1) for line in run("show").splitlines())
    assert json.loads(shown["port"]) == 8765
    assert float(shown["limits.gap_s"]) == Settings().limits.gap_s
    assert "secret" not in "".join(shown.values())
    assert json.loads(run("show", "--json"))["limits"]["gap_s"] == Settings().limits.gap_s


def test_the_schema_has_every_setting():
    for arguments in (("schema",), ("schema", "--json")):
        assert set(json.loads(run(*arguments))["properties"]) == set(Settings.model_fields)


def test_a_key_is_shown_once_and_kept_as_its_digest(folder):
    made = json.loads(run("key", "--name", "bridge", "--scope", "operate", "--scope", "read", "--json"))
    entry = made["entry"]
    assert entry["sha256"] == hashlib.sha256(made["key"].encode()).hexdigest()
    assert entry["scopes"] == ["operate", "read"]
    assert "tags" not in entry
    assert json.loads(run("key", "--name", "bridge", "--json"))["key"] != made["key"]


def test_the_lines_for_the_file_are_settings(folder):
    lines = run("key", "--name", "bridge", "--tag", "b", "--tag", "a").splitlines()
    assert lines[0].startswith("key (shown once): ")
    (folder / "mavcal.toml").write_text("\n".join(lines[1:]))
    [key] = load_settings().api_keys
    assert (key.name, set(key.scopes), set(key.tags)) == ("bridge", {"read"}, {"a", "b"})


@pytest.mark.parametrize(
    ("arguments", "said"), [(("--scope", "fly"), "no scope fly; there are read"), (("--name", ""), "at least 1")]
)
def test_a_key_that_could_not_be_set_is_not_made(arguments, said):
    with pytest.raises(click.UsageError, match=said):
        run("key", "--name", "x", *arguments)


DIGITS = "ab" * 32


def test_keys_that_sign_links_are_kept_listed_and_removed():
    assert "boat" in run("signing", "add", "boat", text=f"{DIGITS}\n")
    made = json.loads(run("signing", "generate", "tug", "--json"))
    listed = json.loads(run("signing", "list", "--json"))["signing_keys"]
    assert [key["name"] for key in listed] == ["boat", "tug"]
    assert made["fingerprint"] == listed[1]["fingerprint"]
    assert made["key"] not in run("signing", "list")
    assert DIGITS not in run("signing", "list", "--json")
    assert run("signing", "remove", "boat").endswith("removed\n")
    assert [line.split()[0] for line in run("signing", "list").splitlines()] == ["tug"]


def test_a_change_of_the_keys_is_in_the_audit_trail():
    run("signing", "generate", "tug")
    run("signing", "remove", "tug")
    assert json.loads(CliRunner().invoke(cli, ["audit", "--json"], standalone_mode=False).stdout)["rows"] == 2
