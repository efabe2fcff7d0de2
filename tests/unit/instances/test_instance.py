"""An instance is the same as before its restart, and another one elsewhere."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from mavcal.service.instances.instance import FILE, owner_of
from mavcal.service.settings import Settings


def settings(folder: Path, **fleet: object) -> Settings:
    return Settings(data_dir=folder, port=8123, fleet=fleet)


def test_the_same_data_directory_is_the_same_instance(tmp_path: Path) -> None:
    first = owner_of(settings(tmp_path))
    again = owner_of(settings(tmp_path, name="Harbour", url="http://harbour:8765/"))
    assert first.id == again.id
    assert len(first.id) == 16
    assert (again.name, again.url) == ("Harbour", "http://harbour:8765/")
    (tmp_path / "other").mkdir()
    assert owner_of(settings(tmp_path / "other")).id != first.id


@pytest.mark.parametrize("kept", ["", "\n"])
def test_an_identity_that_was_cut_off_by_a_crash_is_made_again(tmp_path: Path, kept: str) -> None:
    (tmp_path / FILE).write_text(kept)
    first = owner_of(settings(tmp_path))
    assert first.id
    assert owner_of(settings(tmp_path)).id == first.id


def test_without_a_name_it_is_called_by_its_host_and_port(tmp_path: Path) -> None:
    owner = owner_of(settings(tmp_path))
    assert owner.name == f"{socket.gethostname()}:8123"
    assert str(owner) == owner.name
    assert str(owner_of(settings(tmp_path, name="Harbour", url="http://h/"))) == "Harbour (http://h/)"
