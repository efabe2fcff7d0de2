"""Commands that a sentence names can be run as they stand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from mavcal.service.commands.place import NO_OPTIONS, CommandPlace, place_of
from mavcal.service.settings import default_data_dir

HERE = CommandPlace("tcp:v:1", Path("/d d"))
CHOSEN = CommandPlace(url="http://h:1", vehicle="7")
THERE = CommandPlace(url="http://h:1", key_file=Path("/k"))


@pytest.mark.parametrize(
    ("place", "text", "told"),
    [
        (HERE, "`mavcal recover` finishes it", "`mavcal recover --connect tcp:v:1 --data-dir '/d d'` finishes it"),
        (HERE, "`mavcal accept j --connect udp:w`", "`mavcal accept j --connect udp:w --data-dir '/d d'`"),
        (HERE, "`mavcal campaign resume c`", "`mavcal campaign resume c --connect tcp:v:1 --data-dir '/d d'`"),
        (HERE, "`mavcal fit --help` lists them", "`mavcal fit --help` lists them"),
        (HERE, "`mavcal nonsense`", "`mavcal nonsense`"),
        (HERE, "no command", "no command"),
        (HERE, "`mavcal revert --all`", "`mavcal revert --all --data-dir '/d d'`"),
        (THERE, "`mavcal accept j`", "`mavcal accept j --url http://h:1 --key-file /k`"),
        (THERE, "`mavcal fit --help`", "`mavcal fit --help`"),  # it asks no service
        (CHOSEN, "`mavcal restore --apply`", "`mavcal restore --apply --url http://h:1 --vehicle 7`"),
        (CHOSEN, "`mavcal accept j`", "`mavcal accept j --url http://h:1`"),  # a job says which vehicle
        (CHOSEN, "`mavcal status --all`", "`mavcal status --all --url http://h:1`"),
        (NO_OPTIONS, "`mavcal recover`", "`mavcal recover`"),
    ],
)
def test_a_named_command_has_the_options_of_the_run(place: CommandPlace, text: str, told: str) -> None:
    assert place.completed(text) == told


def test_the_default_data_directory_needs_no_name() -> None:
    kept = SimpleNamespace(connect=("tcp:v:1",), data_dir=default_data_dir().absolute())
    assert place_of(kept) == CommandPlace("tcp:v:1")  # type: ignore[arg-type]
    kept.data_dir = Path("/elsewhere")
    assert place_of(kept) == CommandPlace("tcp:v:1", Path("/elsewhere"))  # type: ignore[arg-type]
