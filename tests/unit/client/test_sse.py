"""A stream of events comes in pieces that break anywhere."""

from __future__ import annotations

import json
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mavcal.client.sse import EventParser

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
ENDS = st.sampled_from(["\n", "\r\n", "\r"])


def parsed(*pieces: bytes) -> list[dict[str, object]]:
    parser = EventParser()
    return [message for piece in pieces for message in parser.feed(piece)]


@given(st.lists(TEXTS, min_size=1, max_size=4), ENDS, st.lists(st.integers(0, 200), max_size=6))
def test_every_message_comes_once_wherever_the_pieces_break(texts, end, cuts):
    told = [json.dumps(text, ensure_ascii=False) for text in texts]
    lines = [part for k, t in enumerate(told) for part in ("event: job", f"id: {k}", f"data: {t}", "")]
    whole = "".join(line + end for line in lines).encode()
    edges = sorted({0, len(whole), *(c for c in cuts if c < len(whole))})
    pieces = [whole[a:b] for a, b in pairwise(edges)]
    found = parsed(*pieces, b": a comment\n")
    assert found == [{"event": "job", "id": str(k), "data": t} for k, t in enumerate(texts)]


def test_a_separator_of_unicode_ends_no_line():
    assert parsed('data: "a\u2028b\x85c"\n\n'.encode()) == [{"data": "a\u2028b\x85c"}]


def test_a_comment_is_no_message_and_an_unfinished_one_waits():
    parser = EventParser()
    assert list(parser.feed(b": ping\n\ndata: 1\n")) == []
    assert list(parser.feed(b"\n")) == [{"data": 1}]
