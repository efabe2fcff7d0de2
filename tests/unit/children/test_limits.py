from __future__ import annotations

import os
import signal

import pytest

from mavcal.service.children.limits import DEFECT, OUT_OF_MEMORY, Limits, cause_of, size_text
from mavcal.service.children.pool import refusal

LIMITS = Limits(3 << 29, 12.5, 60.0)


def killed(number: int) -> int:
    """The wait status of a child that ended with this signal."""
    assert os.WIFSIGNALED(number)
    return number


def left(code: int) -> int:
    """The wait status of a child that ended with this exit code."""
    return code << 8


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (left(OUT_OF_MEMORY), "more than 1.5 GiB of memory"),
        (left(DEFECT), "unexpected error"),
        (left(1), "unexpected error"),
        (killed(signal.SIGXCPU), "more than 12.5 s of processor time"),
        (killed(signal.SIGKILL), "for want of memory"),
        (killed(signal.SIGSEGV), "signal 11 (SIGSEGV)"),
        (killed(signal.SIGRTMIN + 3), f"signal {signal.SIGRTMIN + 3}"),  # one without a name
    ],
)
def test_what_became_of_a_child_is_said_in_words(status, said):
    assert said in cause_of(status, LIMITS)


@pytest.mark.parametrize(
    ("size", "said"),
    [(2**30, "1 GiB"), (3 * 2**29, "1.5 GiB"), (2**28, "256 MiB"), (2**30 + 2**20, "1025 MiB"), (2**29, "512 MiB")],
)
def test_a_size_is_a_round_number_of_the_largest_unit(size, said):
    assert size_text(size) == said


@pytest.mark.parametrize("kind", ["InvalidInputError", "UnreadableError", "FirmwareError"])
def test_a_refusal_of_a_child_is_the_same_error_here(kind):
    error = refusal(kind, "no gyro")
    assert (type(error).__name__, str(error)) == (kind, "no gyro")
