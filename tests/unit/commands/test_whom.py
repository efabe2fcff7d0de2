"""Whom a command is about: what its options may say, and what they may not."""

from __future__ import annotations

from typing import Any

import click
import pytest
from click.testing import CliRunner

from mavcal.service.commands.place import CommandPlace
from mavcal.service.commands.whom import Whom, whom_options

A, B, URL = "udpin:0.0.0.0:14550", "tcp:b:5760", "http://h:1"


def whom_of(*arguments: str, **how: Any) -> Whom:
    """What a command with these options gets."""

    @click.command()
    @whom_options(**how)
    def command(whom: Whom) -> Whom:
        return whom

    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    if result.exception is not None:
        raise result.exception
    assert isinstance(result.return_value, Whom)
    return result.return_value


@pytest.mark.parametrize(
    ("arguments", "how", "said"),
    [
        ((), {}, "give --connect URL of a vehicle, or --url URL of a running service$"),
        ((), {"every": True}, "or --all for every vehicle of the data directory"),
        (("--connect", A, "--url", URL), {}, "exclude each other"),
        (("--url", URL, "--data-dir", "d"), {}, "leave it out"),
        (("--connect", A, "--vehicle", "v1"), {}, "leave it out with --connect"),
        (("--connect", A, "--key-file", __file__), {}, "leave it out with --connect"),
        (("--connect", A, "--connect", B), {"every": True}, "one vehicle at a time"),
        (("--url", URL, "--vehicle", "v1", "--vehicle", "v2"), {}, "one vehicle at a time"),
        (("--url", URL, "--vehicle", "v1", "--all"), {"many": True, "every": True}, "the one or the other"),
    ],
)
def test_what_makes_no_sense_is_wrong_use(arguments: tuple[str, ...], how: dict[str, bool], said: str) -> None:
    with pytest.raises(click.UsageError, match=said):
        whom_of(*arguments, **how)


def test_what_is_given_is_handed_on() -> None:
    assert whom_of("--connect", A, "--wait", "5") == Whom((A,), wait_s=5.0)
    assert whom_of("--connect", A, "--connect", B, many=True) == Whom((A, B))
    assert whom_of("--url", URL, "--vehicle", "7") == Whom(url=URL, ids=("7",))
    assert whom_of("--connect", A, "--vehicle", "v1", campaign=True) == Whom((A,), ids=("v1",))
    assert whom_of(optional=True) == Whom()
    assert whom_of("--all", every=True) == Whom(every=True)


@pytest.mark.parametrize(
    ("whom", "kept"), [(Whom(every=True), ("tcp:kept:1",)), (Whom((A,), every=True), ()), (Whom(), ())]
)
def test_the_endpoints_of_the_settings_count_where_none_is_given(
    monkeypatch: pytest.MonkeyPatch, whom: Whom, kept: tuple[str, ...]
) -> None:
    monkeypatch.setenv("MAVCAL_CONNECT", '["tcp:kept:1"]')
    assert whom.settings.connect == kept


def test_the_next_command_finds_the_same() -> None:
    assert Whom((A,)).place == CommandPlace(A)
    assert Whom((A, B)).place == CommandPlace()
    assert Whom(url=URL, ids=("7",)).place == CommandPlace(url=URL, vehicle="7")
