"""The vehicle from above: arms, numbered motors and how they turn, what is wrong with it, and the wind outside."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from mavcal.calib.airframe.answer import AirframePart, Geometry
from mavcal.calib.drawing import svg, text
from mavcal.calib.gap.schema import EffectEstimate
from mavcal.calib.gap_report.airframe_effects import wind_from
from mavcal.calib.gap_report.colours import BEFORE, MODEL
from mavcal.calib.gap_report.intervals import ratio_of

NARROW, WIDE, HEIGHT = 316, 440, 346
"""Size, px, without and with notes beside the vehicle."""
_CENTRE = 158.0, 190.0
_ARM = 98.0
"""Pixels of the longest arm: everything is drawn to this scale."""
_LARGEST, _SHARE = 0.48, 0.44
"""Largest radius of a rotor, in arms and relative to the distance to the next one. Chosen, not measured: discs that
nearly touch, as on most vehicles."""
_SAME = 1e-3
_COMPASS = 376.0, 78.0
_ROSE = 36.0
_NOTE = 284.0, 294.0

_LEAST_WIND = 0.05
"""Wind speed, m/s, below which no arrow is drawn. Chosen, not measured: a tenth of what a flight shows."""


@dataclass(frozen=True)
class _Place:
    """A motor, or two coaxial ones: numbers from 1, position on the picture, and directions of rotation."""

    numbers: tuple[int, ...]
    x: float
    y: float
    spins: tuple[int, ...]


def vehicle_plot(part: AirframePart, effects: Sequence[EffectEstimate]) -> Markup:
    """The vehicle with its `effects`; empty where its geometry is not known."""
    if part.geometry is None:
        return Markup()
    weak = weak_motors(effects)
    places = list(_places(part.geometry))
    radius = _radius(places)
    drawn = [text(10, 16, f"{part.geometry.frame_class} {part.geometry.frame_type} from above".strip(), kind="title")]
    drawn += [_line(*_CENTRE, place.x, place.y) for place in places]
    drawn.append(_hull())
    for place in places:
        drawn += _rotor(place, radius, weak)
    shift, blows = centre_of_gravity(effects), part.wind is not None and math.hypot(*part.wind) > _LEAST_WIND
    if shift is not None:
        drawn += _shift(*shift)
    if part.wind is not None and blows:
        drawn += _wind(*part.wind)
    return svg(WIDE if blows or shift else NARROW, HEIGHT, drawn, "The vehicle from above, its nose up")


def weak_motors(effects: Sequence[EffectEstimate]) -> Mapping[int, float]:
    """Thrust of each weak motor, real over simulated, by motor number from 1."""
    found = [e for e in effects if e.id == "motor_weak"]
    return {n: ratio_of(p)[0] for e in found for p in e.params if p.name == "s" for n in e.instances}


def centre_of_gravity(effects: Sequence[EffectEstimate]) -> tuple[float, float] | None:
    """Shift of the centre of gravity forward and right of the simulated one, in arms; None without a shift."""
    found = next((e for e in effects if e.id == "cg_offset"), None)
    if found is None:
        return None
    values = {p.name: p.value for p in found.params}
    return values.get("x", 0.0), values.get("y", 0.0)


def on_picture(forward: float, right: float) -> tuple[float, float]:
    """Pixels of a place of the vehicle, given in arms; the nose is up."""
    return _CENTRE[0] + _ARM * right, _CENTRE[1] - _ARM * forward


def _places(geometry: Geometry) -> Iterator[_Place]:
    """Positions of the motors; coaxial motors share one."""
    left = list(enumerate(geometry.motors, start=1))
    while left:
        _, first = left[0]
        here = [(n, m) for n, m in left if math.hypot(m.x - first.x, m.y - first.y) < _SAME]
        left = [pair for pair in left if pair not in here]
        yield _Place(tuple(n for n, _ in here), *on_picture(first.x, first.y), tuple(m.spin for _, m in here))


def _radius(places: Sequence[_Place]) -> float:
    apart = [math.hypot(a.x - b.x, a.y - b.y) for i, a in enumerate(places) for b in places[:i]]
    return min(_LARGEST * _ARM, _SHARE * min(apart, default=math.inf))


def _line(x: float, y: float, to_x: float, to_y: float) -> Markup:
    arm = Markup('<path d="M{:.1f} {:.1f}L{:.1f} {:.1f}" style="stroke:var(--soft)" stroke-width="5" opacity="0.5"/>')
    return arm.format(x, y, to_x, to_y)


def _hull() -> Markup:
    """The body, with a mark for forward."""
    x, y = _CENTRE
    return Markup(
        '<rect x="{:.1f}" y="{:.1f}" width="38" height="46" rx="9" style="fill:var(--page);stroke:var(--soft)"/>'
        '<path class="nose" d="M{:.1f} {:.1f}l9 13h-18z" style="fill:var(--ink)"/>'
    ).format(x - 19, y - 23, x, y - 38)


def _rotor(place: _Place, radius: float, weak: Mapping[int, float]) -> Iterator[Markup]:
    """The disc, filled if a motor differs from the simulated one, its number, and an arrow for each propeller."""
    sick = [n for n in place.numbers if n in weak]
    tooltip = " and ".join(
        f"motor {n}, turns {'counter-clockwise' if spin > 0 else 'clockwise'}"
        + (f", {weak[n]:.2f} times the simulated thrust" if n in weak else "")
        for n, spin in zip(place.numbers, place.spins, strict=True)
    )
    style = f"fill:{BEFORE};stroke:{BEFORE}" if sick else "fill:var(--page);stroke:var(--soft)"
    disc = Markup(
        '<circle class="{}" cx="{:.1f}" cy="{:.1f}" r="{:.1f}" style="{}" fill-opacity="{}"><title>{}</title></circle>'
    )
    kind = "motor weak" if sick else "motor"
    yield disc.format(kind, place.x, place.y, radius, style, "0.9" if sick else "0.75", tooltip)
    colour = "var(--page)" if sick else MODEL
    for k, spin in enumerate(place.spins):
        yield _turning(place.x, place.y, radius * (0.74 - 0.22 * k), spin, colour)
    yield _number(place.x, place.y + 5.0, "+".join(map(str, place.numbers)), "var(--page)" if sick else "var(--ink)")
    for n in sick:
        which = f"{n}: " if len(place.numbers) > 1 else ""
        change = f"{which}{100.0 * (weak[n] - 1.0):+.1f} %"
        yield text(place.x, place.y - radius - 5.0, change, anchor="middle", kind="legend")


def _number(x: float, y: float, words: str, colour: str) -> Markup:
    return Markup(
        '<text x="{:.1f}" y="{:.1f}" text-anchor="middle" style="fill:{};font-size:15px;font-weight:600">{}</text>'
    ).format(x, y, colour, words)


def _turning(x: float, y: float, r: float, spin: int, colour: str) -> Markup:
    """Circular arrow; `spin` +1 is counter-clockwise as seen from above."""
    begin, end = (math.radians(a) for a in ((40.0, 320.0) if spin > 0 else (140.0, -140.0)))
    x0, y0, x1, y1 = x + r * math.cos(begin), y - r * math.sin(begin), x + r * math.cos(end), y - r * math.sin(end)
    arc = Markup('<path d="M{:.1f} {:.1f}A{:.1f} {:.1f} 0 1 {} {:.1f} {:.1f}" fill="none" style="stroke:{}"/>').format(
        x0, y0, r, r, 0 if spin > 0 else 1, x1, y1, colour
    )
    return arc + _head(x1, y1, -spin * math.sin(end), spin * math.cos(end), 6.0, colour)


def _head(x: float, y: float, right: float, up: float, size: float, colour: str) -> Markup:
    """The head of an arrow whose tip is at a place; `right` and `up` are its direction, of length one."""
    back_x, back_y = x - size * right, y + size * up
    side_x, side_y = 0.5 * size * up, 0.5 * size * right
    return Markup('<path d="M{:.1f} {:.1f}L{:.1f} {:.1f}L{:.1f} {:.1f}z" style="fill:{}"/>').format(
        x, y, back_x + side_x, back_y + side_y, back_x - side_x, back_y - side_y, colour
    )


def _arrow(x: float, y: float, to_x: float, to_y: float, colour: str, *, wide: float, head: float) -> Markup:
    """An arrow whose head is never longer than the arrow."""
    long = math.hypot(to_x - x, to_y - y)
    if long <= 0.0:
        return Markup()
    right, up, size = (to_x - x) / long, (y - to_y) / long, min(head, 0.8 * long)
    shaft = Markup('<path d="M{:.1f} {:.1f}L{:.1f} {:.1f}" style="stroke:{}" stroke-width="{:g}"/>').format(
        x, y, to_x - 0.8 * size * right, to_y + 0.8 * size * up, colour, wide
    )
    return shaft + _head(to_x, to_y, right, up, size, colour)


def _shift(forward: float, right: float) -> Iterator[Markup]:
    """The shifted centre of gravity, to the scale of the arms, on a cross at the simulated one; and how far it is."""
    x, y = _CENTRE
    at_x, at_y = on_picture(forward, right)
    yield Markup('<path d="M{:.1f} {:.1f}h28M{:.1f} {:.1f}v28" style="stroke:var(--soft)"/>').format(
        x - 14, y, x, y - 14
    )
    yield Markup(
        '<circle class="gravity" cx="{:.2f}" cy="{:.2f}" r="5" fill="none" style="stroke:{}" stroke-width="1.5"/>'
    ).format(at_x, at_y, BEFORE)
    yield _arrow(x, y, at_x, at_y, BEFORE, wide=1.5, head=8.0)
    lines = (
        "centre of gravity",
        f"{100.0 * abs(forward):.1f} % of an arm {'forward' if forward >= 0.0 else 'back'}",
        f"{100.0 * abs(right):.1f} % {'right' if right >= 0.0 else 'left'}",
    )
    for k, words in enumerate(lines):
        yield text(_NOTE[0], _NOTE[1] + 15 * k, words, kind="legend")


def _wind(north: float, east: float) -> Iterator[Markup]:
    """A compass beside the vehicle, north up, with an arrow in the direction of the wind."""
    x, y = _COMPASS
    speed, direction = wind_from(north, east)
    unit_north, unit_east = north / speed, east / speed
    yield Markup('<circle class="grid" cx="{:.1f}" cy="{:.1f}" r="{:g}"/>').format(x, y, _ROSE)
    yield text(x, y - _ROSE - 5, "N", anchor="middle")
    reach = 0.85 * _ROSE
    yield Markup('<g class="wind">{}</g>').format(
        _arrow(x - reach * unit_east, y + reach * unit_north, x + reach * unit_east, y - reach * unit_north, MODEL,
               wide=3.0, head=13.0)
    )  # fmt: skip
    yield text(x, y + _ROSE + 16, f"wind {speed:.1f} m/s", anchor="middle", kind="legend")
    yield text(x, y + _ROSE + 31, f"from {direction:.0f} deg", anchor="middle", kind="legend")
