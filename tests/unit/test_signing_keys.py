"""Signing keys: named, kept where their owner alone reads them, never told."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from mavcal.service.errors import SigningKeyError, SigningKeyUnknown
from mavcal.service.settings import MavlinkSettings
from mavcal.service.signing_keys import FILE, SigningKeys, fingerprint

ONE, TWO = "1a" * 32, "2b" * 32


def keys(folder: Path, **settings: object) -> SigningKeys:
    return SigningKeys(folder, MavlinkSettings.model_validate(settings))


def test_a_key_is_kept_in_a_file_that_its_owner_alone_can_read(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        keys(tmp_path).add("boat", ONE)
    finally:
        os.umask(before)
    assert (tmp_path / FILE).stat().st_mode & 0o777 == 0o600
    assert keys(tmp_path).named("boat") == ("boat", bytes.fromhex(ONE))
    assert [path.name for path in tmp_path.iterdir()] == [FILE]


def test_a_file_that_others_can_read_is_refused_with_the_remedy(tmp_path: Path) -> None:
    keys(tmp_path).add("boat", ONE)
    (tmp_path / FILE).chmod(0o640)
    with pytest.raises(SigningKeyError, match="chmod 600"):
        keys(tmp_path).named("boat")


@pytest.mark.parametrize("text", ["", "[]", '{"keys": {"boat": "12"}}', '{"keys": ["boat"]}', '{"keys": {"../x": 1}}'])
def test_a_damaged_file_is_said_to_be_damaged(tmp_path: Path, text: str) -> None:
    (tmp_path / FILE).write_text(text)
    (tmp_path / FILE).chmod(0o600)
    with pytest.raises(SigningKeyError, match="damaged"):
        keys(tmp_path).all()


def test_what_is_listed_tells_keys_apart_and_does_not_tell_them(tmp_path: Path) -> None:
    known = keys(tmp_path, signing_keys={"plane": TWO}, signing_key=ONE)
    made, digits = known.add("boat")
    listed = known.all()
    assert [(key.name, key.source) for key in listed] == [
        ("boat", "file"),
        ("default", "settings"),
        ("plane", "settings"),
    ]
    assert made.fingerprint == fingerprint(digits)
    assert not any(digits in repr(key) or ONE in repr(key) for key in listed)
    assert len({key.fingerprint for key in listed}) == 3


def test_a_link_gets_the_key_it_names_else_the_default_and_never_none_for_an_unknown_one(tmp_path: Path) -> None:
    known = keys(tmp_path, signing_key=ONE)
    known.add("boat", TWO)
    assert known.named(None) == ("default", bytes.fromhex(ONE))
    assert known.named("boat") == ("boat", bytes.fromhex(TWO))
    assert known.named("none") is None
    assert keys(tmp_path).named(None) is None
    with pytest.raises(SigningKeyUnknown, match=r"plane.*known: boat, default"):
        known.named("plane")


@pytest.mark.parametrize("name", ["", "default", "none", "a b", "../x", "x" * 65])
def test_a_name_that_is_none_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(SigningKeyError, match="cannot name"):
        keys(tmp_path).add(name, ONE)


def test_no_key_takes_the_place_of_another(tmp_path: Path) -> None:
    known = keys(tmp_path, signing_keys={"plane": TWO})
    known.add("boat", ONE)
    for name in ("boat", "plane"):
        with pytest.raises(SigningKeyError, match="already"):
            known.add(name, TWO)
    with pytest.raises(SigningKeyError, match="64 hexadecimal digits"):
        known.add("car", "12")
    with pytest.raises(SigningKeyError, match="settings"):
        known.remove("plane")
    assert known.remove("boat").fingerprint == fingerprint(ONE)
    with pytest.raises(SigningKeyUnknown):
        known.remove("boat")
    assert json.loads((tmp_path / FILE).read_text()) == {"keys": {}}


def test_a_write_that_broke_off_leaves_the_keys_before(tmp_path: Path) -> None:
    keys(tmp_path).add("boat", ONE)
    (tmp_path / FILE).with_suffix(".new").write_text('{"keys": {')
    keys(tmp_path).add("plane", TWO)
    assert [key.name for key in keys(tmp_path).all()] == ["boat", "plane"]
