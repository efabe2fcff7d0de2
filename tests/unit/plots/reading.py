"""Reads a picture as a person does: titles, names of axes, and numbers by the ticks beside them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from xml.etree import ElementTree

import numpy as np

from mavcal.calib.drawing import Drawing

SVG = "{http://www.w3.org/2000/svg}"
LOG = "Hz", "averaging time", "Allan"
"""Words of an axis that is logarithmic."""


@dataclass(frozen=True)
class Mark:
    """Something drawn: a line, dots, a band or columns, with its points on the scales of the axes (N, 2)."""

    tag: str
    colour: str
    dashed: bool
    points: np.ndarray

    @property
    def x(self) -> np.ndarray:
        return self.points[:, 0]

    @property
    def y(self) -> np.ndarray:
        return self.points[:, 1]


@dataclass(frozen=True)
class Panel:
    """One pair of axes, or a map, or words alone."""

    texts: list[str]
    labels: list[str]
    title: str
    marks: list[Mark]
    keys: list[tuple[str, bool, str]]

    @property
    def lines(self) -> list[Mark]:
        return [mark for mark in self.marks if mark.tag == "polyline"]

    def drawn(self, name: str) -> Mark:
        """What the legend calls `name`, with or without what follows a comma."""
        colour, dots, _ = next(key for key in self.keys if key[2].split(",")[0] == name)
        tags = ("dots",) if dots else ("polyline", "columns")
        return next(mark for mark in self.marks if mark.colour == colour and mark.tag in tags)


def heading(drawing: Drawing) -> str:
    return next(e.text for e in ElementTree.fromstring(drawing.svg).iter(f"{SVG}text") if e.get("class") == "heading")


def panels_of(drawing: Drawing) -> list[Panel]:
    assert "nan" not in drawing.svg
    return [_panel(group) for group in ElementTree.fromstring(drawing.svg).findall(f"{SVG}g")]


def _panel(group: ElementTree.Element) -> Panel:
    elements = [(element.tag.removeprefix(SVG), element) for element in group]
    texts = list(group.iter(f"{SVG}text"))
    labels = [str(t.text) for t in texts if t.get("class") == "axis"]
    title = next((str(t.text or "") for t in texts if t.get("class") == "title"), "")
    keys = [
        (_colour(sign), sign.get("stroke-linecap") is not None, str(name.text))
        for (_, sign), (_, name) in pairwise(elements)
        if name.get("class") == "legend"
    ]
    drawn = [
        e for k, (_, e) in enumerate(elements) if k + 1 == len(elements) or elements[k + 1][1].get("class") != "legend"
    ]
    scales = [_scale(texts, labels, axis) for axis in (0, 1)] if len(labels) == 2 else [None, None]
    marks = [mark for element in drawn if (mark := _mark(element, scales)) is not None]
    return Panel([str(t.text) for t in texts if t.text], labels, title, marks, keys)


def _colour(element: ElementTree.Element) -> str:
    return (element.get("style") or "").partition(":")[2]


def _scale(texts: list[ElementTree.Element], labels: list[str], axis: int) -> tuple[float, float, bool] | None:
    """Slope and foot of a number by its place, and whether the axis is logarithmic."""
    anchor, across = ("middle", "x") if axis == 0 else ("end", "y")
    bare = [t for t in texts if t.get("class") is None and t.get("text-anchor") == anchor]
    ticks = [
        (float(t.attrib[across]), t.text or "") for t in bare if re.fullmatch(r"-?[\d.]+(e[+-]\d+)?", t.text or "")
    ]
    if len(ticks) < 2:
        return None
    log = any(word in labels[axis] for word in LOG)
    places, values = np.array([place for place, _ in ticks]), np.array([float(word) for _, word in ticks])
    slope, foot = np.polyfit(places - (0.0 if axis == 0 else 3.5), np.log10(values) if log else values, 1)
    return float(slope), float(foot), log


def _mark(element: ElementTree.Element, scales: list[tuple[float, float, bool] | None]) -> Mark | None:
    tag = element.tag.removeprefix(SVG)
    if tag not in {"polyline", "polygon", "path"} or element.get("class"):
        return None
    path = element.get("points") or element.get("d") or ""
    if tag == "path":
        tag = "dots" if element.get("stroke-linecap") else "columns"
    found = [(float(a), float(b)) for a, b in re.findall(r"(-?[\d.]+)[ ,](-?[\d.]+)", path)]
    if tag == "columns" and "V" in path:  # their heads
        found = [(float(a), float(b)) for a, b in re.findall(r"M(-?[\d.]+) -?[\d.]+V(-?[\d.]+)", path)]
    points = np.array(found).reshape(-1, 2)
    for axis, scale in enumerate(scales):
        if scale is not None:
            values = scale[0] * points[:, axis] + scale[1]
            points[:, axis] = 10.0**values if scale[2] else values
    return Mark(tag, _colour(element), element.get("stroke-dasharray") is not None, points)
