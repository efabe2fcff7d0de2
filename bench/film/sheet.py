"""Frames of a page as one picture: a contact sheet with the time under each."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

COLORS = 128
GAP = 14
CAPTION = 26
PAPER, INK = "#e9edf2", "#14202e"


@dataclass(frozen=True)
class Frame:
    """A screenshot (PNG), its time after the start in s, and its caption."""

    at: float
    png: bytes
    about: tuple[object, ...] = ()


def thinned(frames: Sequence[Frame], most: int) -> list[Frame]:
    """At most so many frames of one state with one prompt: the first, the last, and others between them."""
    groups: dict[tuple[object, ...], list[Frame]] = {}
    for frame in frames:
        groups.setdefault(frame.about[:2], []).append(frame)
    return sorted((frame for group in groups.values() for frame in chosen(group, most)), key=lambda frame: frame.at)


def chosen(frames: Sequence[Frame], count: int) -> list[Frame]:
    """The first, the last, and others spread evenly over the changes between them."""
    if len(frames) <= count:
        return list(frames)
    step = (len(frames) - 1) / (count - 1)
    return [frames[round(k * step)] for k in range(count)]


def contact_sheet(frames: Sequence[Frame], columns: int, width: int) -> Image.Image:
    """The frames in rows, each `width` pixels wide, with its minute and second below."""
    shots = [Image.open(io.BytesIO(frame.png)).convert("RGB") for frame in frames]
    height = round(width * shots[0].height / shots[0].width)
    rows = -(-len(shots) // columns)
    size = (columns * (width + GAP) + GAP, rows * (height + CAPTION + GAP) + GAP)
    sheet = Image.new("RGB", size, PAPER)
    pen, letters = ImageDraw.Draw(sheet), ImageFont.load_default(16)
    for k, (frame, shot) in enumerate(zip(frames, shots, strict=True)):
        x, y = GAP + k % columns * (width + GAP), GAP + k // columns * (height + CAPTION + GAP)
        sheet.paste(shot.resize((width, height), Image.Resampling.LANCZOS), (x, y))
        minutes, seconds = divmod(round(frame.at), 60)
        pen.text((x + 2, y + height + 4), f"{minutes}:{seconds:02d}", fill=INK, font=letters)
    return sheet


def save(image: Image.Image, path: Path, most_bytes: int, colors: int = COLORS) -> None:
    """A PNG with a palette.

    Raises
    ------
    ValueError
        If it is larger than `most_bytes`.
    """
    image.convert("RGB").quantize(colors, dither=Image.Dither.NONE).save(path, optimize=True)
    if path.stat().st_size > most_bytes:
        raise ValueError(f"{path.name} has {path.stat().st_size} bytes, and should have at most {most_bytes}")
