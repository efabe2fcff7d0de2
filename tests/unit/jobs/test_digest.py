from __future__ import annotations

import hashlib
from pathlib import Path

import pytest

from service.errors import CaptureEnded
from service.jobs.digest import FitRequest, content_of, fit_segments
from service.jobs.model import Span

CONTENT = bytes(range(256)) * 8


@pytest.fixture
def span(tmp_path: Path) -> Span:
    path = tmp_path / "a.tlog"
    path.write_bytes(b"before" + CONTENT + b"behind")
    return Span(path, 6, 6 + len(CONTENT), hashlib.sha256(CONTENT).hexdigest())


def test_a_segment_is_read_as_it_was_closed(span: Span) -> None:
    assert content_of(span) == CONTENT


def test_a_segment_that_has_changed_by_one_bit_is_not_fitted(span: Span) -> None:
    damaged = bytearray(span.path.read_bytes())
    damaged[100] ^= 1
    span.path.write_bytes(damaged)
    with pytest.raises(CaptureEnded, match="not what it was"):
        content_of(span)
    with pytest.raises(CaptureEnded, match="not what it was"):
        fit_segments(FitRequest("gyro", {}, (span,), 1, 0.0))


def test_a_segment_that_was_cut_off_or_has_gone_is_not_fitted(span: Span) -> None:
    span.path.write_bytes(span.path.read_bytes()[:-100])
    with pytest.raises(CaptureEnded, match="not what it was"):
        content_of(span)
    span.path.unlink()
    with pytest.raises(CaptureEnded, match="cannot be read"):
        content_of(span)
