from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcal.service.workers.queue import BELOW, moved
from tests.examples import examples

OURS, THEIRS = Path("/instance/uploads"), Path("/worker/mnt")
NAMES = st.text("abc01.-", min_size=1, max_size=8).filter(lambda name: name not in {".", ".."})
PATHS = NAMES.map(lambda name: str(OURS / name))
PLAIN = st.none() | st.booleans() | st.floats(allow_nan=False) | NAMES
ORDERS = st.dictionaries(NAMES, PLAIN | PATHS | st.lists(PATHS, max_size=2) | st.dictionaries(NAMES, PATHS, max_size=2))


@pytest.mark.long
@settings(max_examples=examples(25))
@given(ORDERS)
def test_an_order_that_goes_to_a_worker_and_back_is_the_same(order):
    sent = moved(order, OURS, None)
    assert moved(sent, None, OURS) == order
    assert str(OURS) not in repr(sent)


def test_a_worker_finds_the_file_in_its_own_folder():
    sent = moved({"real": {"path": "/instance/uploads/a.bin"}, "nominal": ["/instance/uploads/b.csv"]}, OURS, None)
    assert moved(sent, None, THEIRS) == {"real": {"path": "/worker/mnt/a.bin"}, "nominal": ["/worker/mnt/b.csv"]}


def test_only_what_lies_in_the_folder_itself_is_moved():
    elsewhere = ["/instance/uploads", "/instance/uploads/below/a.bin", "/instance/a.bin", "a.bin", 7, None, True]
    assert moved(elsewhere, OURS, None) == elsewhere


def test_a_name_that_leads_out_of_the_folder_does_not():
    assert moved(f"{BELOW}../../etc/passwd", None, THEIRS) == "/worker/mnt/passwd"
