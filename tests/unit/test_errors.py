"""The tree of errors: what clients tell errors by, and what people read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from http import HTTPStatus

import pytest

from mavcal.service import errors
from mavcal.service.errors import (
    CaptureEnded,
    ChildEnded,
    CommandRefused,
    ParameterRejected,
    ServiceError,
    TooManyAttempts,
)

STATUS = re.compile(r"^(?P<indent>[ |]*)(?:\+-- )?(?P<name>[A-Z]\w+) +(?P<status>\d{3})")


def tree(of: type[ServiceError] = ServiceError) -> Iterator[type[ServiceError]]:
    """The error and every one below it that the module defines."""
    yield of
    for below in of.__subclasses__():
        if below.__module__.startswith(errors.__name__):
            yield from tree(below)


def drawn() -> dict[str, tuple[str | None, int]]:
    """Parent and status of every error, as the docstring of the module draws them."""
    found: dict[str, tuple[str | None, int]] = {}
    parents: list[tuple[int, str]] = []
    for line in str(errors.__doc__).splitlines():
        match = STATUS.match(line)
        if match is None:
            continue
        depth = len(match["indent"])
        depth += 1 if "+--" in line else 0
        while parents and parents[-1][0] >= depth:
            parents.pop()
        found[match["name"]] = (parents[-1][1] if parents else None, int(match["status"]))
        parents.append((depth, match["name"]))
    return found


CLASSES = list(tree())
NAMES = [made.__name__ for made in CLASSES]


def test_the_tree_in_the_docstring_is_the_tree_of_the_classes() -> None:
    actual = {
        made.__name__: (None if made is ServiceError else made.__mro__[1].__name__, made.status_code)
        for made in CLASSES
    }
    assert drawn() == actual


def test_clients_can_tell_errors_apart_by_their_code() -> None:
    codes = [made.code for made in CLASSES]
    assert sorted(code for code in set(codes) if codes.count(code) > 1) == []
    assert [code for code in codes if not re.fullmatch(r"[a-z]+(-[a-z]+)*", code)] == []


def test_a_title_belongs_to_one_error() -> None:
    titles = [made.title for made in CLASSES]
    assert sorted(title for title in set(titles) if titles.count(title) > 1) == []


def test_only_what_is_not_there_answers_404() -> None:
    """Clients take 404 for an absence and try no more; a refusal of what exists has another status."""
    absent = [made for made in CLASSES if made.status_code == HTTPStatus.NOT_FOUND]
    assert [made.code for made in absent if not made.code.endswith(("-unknown", "-missing"))] == []


@pytest.mark.sampled
@pytest.mark.parametrize("made", CLASSES, ids=NAMES)
def test_without_a_message_an_error_says_what_its_class_means(made: type[ServiceError]) -> None:
    said = str(made())
    assert len(said) > 15
    assert made("instead").args == ("instead",) or made is ChildEnded
    if made is not ChildEnded:
        assert said == made.__doc__
        assert said[0].isupper()
        assert said.endswith(".")


def test_an_empty_message_is_none() -> None:
    assert str(ServiceError("")) == str(ServiceError())


def test_who_tried_too_often_is_told_how_long_to_wait() -> None:
    assert TooManyAttempts("wait", wait_s=12.5).wait_s == 12.5
    assert TooManyAttempts().wait_s == 0.0


def test_a_file_that_was_not_processed_says_why_after_a_colon() -> None:
    made = ChildEnded("too slow")
    assert made.cause == "too slow"
    assert str(made).endswith(": too slow")


def test_what_a_vehicle_refused_names_the_command_and_the_parameter() -> None:
    refused = CommandRefused("no", command=241, result=2)
    assert (refused.command, refused.result) == (241, 2)
    rejected = ParameterRejected("no", name="CAL_GYRO0_XOFF", sent=3)
    assert (rejected.name, rejected.sent) == ("CAL_GYRO0_XOFF", 3)


def test_a_capture_that_ended_says_what_helps() -> None:
    assert CaptureEnded().remedy
    assert CaptureEnded("too hot", remedy="Cool it.").remedy == "Cool it."
