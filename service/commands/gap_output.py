"""What ``mavcal gap`` prints of airframe and air: lines of 80 columns."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavcal.calib.airframe.answer import AirframePart, Rollout
    from mavcal.calib.gap.schema import EffectEstimate
    from mavcal.calib.gap.verify import Left

WIDTH = 80


def effect_lines(effect: EffectEstimate) -> list[str]:
    """An effect of airframe or air: what was found, how sure that is, its numbers, and its rivals."""
    from mavcal.calib.gap_report.airframe_effects import claims, rival_phrase
    from mavcal.calib.gap_report.words import chance, effect_phrase, held_out

    phrase = effect_phrase(effect)
    lines = wrapped(f"{phrase[0].upper()}{phrase[1:]}")
    likelier = ", something else is likelier" if effect.evidence.doubtful else ""
    sure = f"{effect.id}, probability {chance(effect.evidence.probability)}{likelier}; {held_out(effect)}"
    lines += wrapped(sure, "    ")
    for claim in claims(effect):
        said = f"{claim.label}: {claim.difference}" + (f" ({claim.interval})" if claim.interval else "")
        lines += wrapped(f"{said}; {claim.sides}" if claim.sides else said, "    ")
    for rival in effect.confusable_with:
        lines += wrapped(f"could also be {rival_phrase(rival)}", "    ")
    return lines


def remainder_lines(left: Left) -> Iterator[str]:
    """What is left of an effect of the airframe, parameter by parameter."""
    from mavcal.calib.gap_report.words import number

    motor = "" if not left.instances else f" of motor {', '.join(map(str, left.instances))}"
    for name, one in left.remainders.items():
        nothing, what = (1.0, "real by new") if one.ratio else (0.0, "real less new")
        within = f"within two standard errors of {nothing:g}" if one.within else "not closed"
        unseen = "; the new flight does not show the effect" if left.again is None else ""
        said = f"{left.id}{motor}: {name}, {what} {nothing + one.value:.4g} ± {number(one.se)}, {within}{unseen}"
        yield from wrapped(said)


def flight_lines(part: AirframePart) -> Iterator[str]:
    """How far the prediction improves, what to fly next, and whence frame and commands are known."""
    from mavcal.calib.gap_report.airframe_words import commands_sentence, geometry_sentence

    if part.rollout:
        yield from _table(part.rollout)
    if part.manoeuvres:
        yield "To decide between what is left, fly:"
        for manoeuvre in part.manoeuvres:
            yield from wrapped(manoeuvre)
    if part.geometry is not None:
        yield from wrapped(geometry_sentence(part.geometry), "")
    if part.commands is not None:
        yield from wrapped(commands_sentence(part.commands), "")


def _table(rollouts: Iterable[Rollout]) -> Iterator[str]:
    """The error of the predicted flight: a row for each horizon."""
    from mavcal.calib.gap_report.airframe_words import closed_words, part_name, quantity_name, sized

    yield "Predicted flight, on data that were held out:"
    yield f"  {'error':28}{'before':>8}{'after':>8}{'floor':>8}"
    for one in rollouts:
        name = f"{quantity_name(one)}, {one.unit}"
        numbers = "".join(f"{sized(one, error):>8}" for error in (one.before, one.after, one.floor))
        yield f"  {name:28}{numbers}  {', '.join(filter(None, (closed_words(one), part_name(one))))}".rstrip()


def wrapped(text: str, indent: str = "  ") -> list[str]:
    """A text in lines, the further ones two columns deeper; words are never broken."""
    return textwrap.wrap(
        text, WIDTH, initial_indent=indent, subsequent_indent=f"{indent}  ", break_long_words=False,
        break_on_hyphens=False,
    )  # fmt: skip
