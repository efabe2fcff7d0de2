from __future__ import annotations

import io
from pathlib import Path

import pytest

pytest.importorskip("PIL", reason="Pillow is not installed")

from PIL import Image

from bench.film.rooms import at_rest, flown
from bench.film.sheet import CAPTION, GAP, Frame, chosen, contact_sheet, save, thinned


def frames(count: int, about: tuple[object, ...] = ("Measuring", "Hold it")) -> list[Frame]:
    out = io.BytesIO()
    Image.new("RGB", (40, 80), "red").save(out, "PNG")
    return [Frame(float(k), out.getvalue(), about) for k in range(count)]


def test_first_and_last_are_always_among_the_chosen() -> None:
    assert [frame.at for frame in chosen(frames(23), 4)] == [0, 7, 15, 22]
    assert chosen(frames(3), 12) == frames(3)


def test_one_prompt_does_not_fill_the_sheet() -> None:
    many = [*frames(9), Frame(9.0, b"", ("Writing", "Leave it"))]
    assert [frame.at for frame in thinned(many, 2)] == [0, 8, 9]


def test_a_sheet_has_a_place_for_each_frame_and_its_time() -> None:
    sheet = contact_sheet(frames(5), columns=3, width=20)
    assert sheet.size == (3 * (20 + GAP) + GAP, 2 * (40 + CAPTION + GAP) + GAP)
    assert sheet.getpixel((GAP + 10, GAP + 20)) == (255, 0, 0)


def test_a_picture_that_is_too_large_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at most 10"):
        save(contact_sheet(frames(1), 1, 20), tmp_path / "a.png", 10)


def test_logs_are_the_same_for_the_same_seed() -> None:
    assert flown() == flown()
    assert at_rest(seed=1) != at_rest(seed=2)
