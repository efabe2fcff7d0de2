"""What a fault run does: which vehicle, which job, which faults strike when. Everything is drawn from a seed."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import chain, cycle, islice, repeat
from typing import Any

Json = dict[str, Any]

SPEED = 20.0
"""Vehicle seconds per wall second."""
SLOWER = 5.0
"""The same where a bad wire costs wall time that must not look like a restarted clock or a drifted gyro."""

WIRE = ("loss", "duplication", "reordering", "delay", "bit_errors", "truncation")
ECHO = ("lost_echo", "late_echo")
BENIGN = WIRE + ECHO
"""What a write has to survive."""
STOPPING = ("arm", "reboot", "silence", "onboard_calibration", "move", "twin")
"""After these nothing more may be written until the vehicle is known again."""
SENSOR = ("stuck", "nan", "absent")
FALSE = ("not_applied", "foreign_write", *SENSOR)
"""The write goes on, but what the vehicle holds or shows is not what was written."""
SECOND_LINK, LINK_DIES, LINK_DELETED = LINKS = ("second_link", "link_dies", "link_deleted")
"""One vehicle on two links: the second appears, the first falls silent for good, the first is to be closed."""
KINDS = BENIGN + STOPPING + FALSE + LINKS

ONE_LINK = 224
"""So many runs have one link; those that follow have two."""
OWN, OTHER = "own", "other"
"""The sensor that the job calibrates, or one that it does not."""
OTHER_SENSOR = {"gyro": "mag", "accel": "mag", "mag": "gyro"}
UNRELATED_PARAMETER = {"ardupilot": "RTL_ALT", "px4": "MPC_THR_HOVER"}
OPTIONS: dict[str, Json] = {
    "gyro": {"uncertainty": 0.03},
    "accel": {"uncertainty": 0.02, "obliques": 3.0},
    "mag": {"uncertainty": 1.0},
}
"""Looser than the defaults, so that a run is short."""


class Phase(StrEnum):
    """When a fault is let loose. All of these lie after the first PARAM_SET."""

    WRITE = "write"  # with the n-th PARAM_SET
    VERIFY = "verify"  # as soon as the job is verifying
    ROLL_BACK = "roll_back"  # as soon as the job takes its write back


@dataclass(frozen=True)
class Strike:
    """One fault: its kind, when, and its options; `share` places an n-th PARAM_SET among those of the plan.

    The option `wall_s` is a `duration_s` in seconds of the wall clock.
    """

    kind: str
    phase: Phase
    share: float = 0.0
    options: Json = field(default_factory=dict)


@dataclass(frozen=True)
class Scenario:
    """One fault run."""

    index: int
    seed: int
    recipe: str
    autopilot: str
    job: str
    strikes: tuple[Strike, ...]
    ambient: tuple[Strike, ...]
    """On the wire from before the capture on; not counted."""
    speed: float
    resolve: bool
    """Whether an operator puts things right when the job is in doubt; otherwise the run ends there."""
    config: Json
    links: int = 1
    """How many links the vehicle serves."""


def scenarios(count: int, seed: int) -> tuple[Scenario, ...]:
    """The `count` runs of a campaign; run `i` of the same seed is always the same."""
    recipes = chain(islice(cycle(_ROTATION), ONE_LINK), repeat("links"))
    decks: dict[str, Iterator[str]] = {name: cycle(kinds) for name, kinds in _DECKS.items()}
    return tuple(_scenario(i, seed, next(recipes), decks) for i in range(count))


_ROTATION = (
    "wire", "check", "false", "harmless", "stop", "check", "harmless", "false", "check", "harmless",
    "stop", "check", "false", "harmless", "check", "wire", "false", "harmless", "check", "stop",
)  # fmt: skip
_DECKS: dict[str, tuple[str, ...]] = {
    "benign": BENIGN,
    "check": STOPPING,
    "stop": STOPPING,
    "false": ("not_applied", "foreign_write", "not_applied", "stuck", "not_applied", "nan", "absent", "foreign_write"),
    "links": LINKS,
    "harmless": ("foreign_write", "stuck", "silence", "nan", "absent"),
}


def _scenario(index: int, seed: int, recipe: str, decks: dict[str, Iterator[str]]) -> Scenario:
    draw = random.Random(f"campaign {seed} {index}")
    autopilot = ("ardupilot", "px4")[index % 2]
    strikes = list(_RECIPES[recipe](draw, decks, autopilot))
    slow = any(_takes_time(recipe, strike.kind) for strike in strikes)
    # at the slower speed the longer jobs would take minutes
    job = "gyro" if slow else draw.choices(("gyro", "accel", "mag"), (0.6, 0.25, 0.15))[0]
    ambient = [_wire(draw, kind, Phase.WRITE, gentle=True) for kind in draw.sample(("loss", "duplication"), 1)]
    return Scenario(
        index,
        seed,
        recipe,
        autopilot,
        job,
        tuple(_about(strike, job) for strike in strikes),
        tuple(ambient) if draw.random() < 0.2 else (),
        speed=SLOWER if slow else SPEED,
        resolve=_resolved(draw, recipe, strikes),
        config=_config(draw, autopilot),
        links=2 if recipe == "links" else 1,
    )


def _takes_time(recipe: str, kind: str) -> bool:
    """Whether a fault holds frames back, or makes the check long after its first window of the stream.

    The gyro may drift between the two windows of a check, by the vehicle's clock: nothing small can be shown then.
    """
    return kind in ("reordering", "delay") or (recipe == "false" and kind in WIRE)


def _about(strike: Strike, job: str) -> Strike:
    """The same with its sensor by name."""
    if "sensor" not in strike.options:
        return strike
    sensor = job if strike.options["sensor"] == OWN else OTHER_SENSOR[job]
    return replace(strike, options={**strike.options, "sensor": sensor})


def _resolved(draw: random.Random, recipe: str, strikes: Iterable[Strike]) -> bool:
    twin = any(strike.kind == "twin" for strike in strikes)  # a doubt about who is who holds for half a minute
    return draw.random() < (0.3 if twin and recipe == "stop" else 0.95 if recipe == "check" else 0.6)


def _config(draw: random.Random, autopilot: str) -> Json:
    """Without drift with temperature; without the autopilot's own gyro calibration, mostly."""
    parameters = {"INS_GYR_CAL": 0} if autopilot == "ardupilot" else {"IMU_GYRO_CAL_EN": int(draw.random() < 0.2)}
    old = autopilot == "ardupilot" and draw.random() < 0.5  # ArduPilot up to 4.5
    return {"thermal": False, "parameters": parameters, "boot_s": draw.choice((3.0, 20.0, 90.0)), "highres": not old}


# --- recipes


def _wires(draw: random.Random, decks: dict[str, Iterator[str]], count: int) -> Iterator[Strike]:
    for kind in dict.fromkeys(next(decks["benign"]) for _ in range(count)):
        if kind in WIRE:
            yield _wire(draw, kind, Phase.WRITE)
        else:
            options: Json = {"count": draw.randint(1, 3)}
            options |= {"delay_s": draw.uniform(1.0, 40.0)} if kind == "late_echo" else {}
            yield Strike(kind, Phase.WRITE, draw.random(), options)


def _wire(draw: random.Random, kind: str, phase: Phase, *, gentle: bool = False) -> Strike:
    if kind == "delay":
        options: Json = {"delay_s": draw.uniform(0.02, 0.3), "jitter_s": draw.uniform(0.0, 0.2)}
    else:
        options = {"p": 0.04 if gentle else draw.uniform(0.03, 0.2)}
    if not gentle:
        options["direction"] = draw.choice(("both", "both", "in", "out"))
    return Strike(kind, phase, draw.random() * 0.8, options)


def _recipe_wire(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    yield from _wires(draw, decks, draw.randint(2, 3))


def _recipe_harmless(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    """Faults beside the write: another sensor, another parameter, a silence that is too short to matter."""
    yield from _wires(draw, decks, 2)
    kind = next(decks["harmless"])
    if kind == "silence":
        yield Strike(kind, Phase.WRITE, draw.random(), {"wall_s": draw.uniform(0.3, 2.0)})
    elif kind == "foreign_write":
        name = UNRELATED_PARAMETER[autopilot]
        yield Strike(kind, Phase.WRITE, draw.random(), {"name": name, "value": 0.25 if autopilot == "px4" else 1250})
    else:
        options = {"sensor": OTHER, "instance": draw.randint(0, 1)}
        yield Strike(kind, Phase.WRITE, draw.random(), options)


def _recipe_links(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    """The vehicle is heard on a second link as well, from the start or in mid-write."""
    kind = next(decks["links"])
    yield Strike(kind, Phase.WRITE, draw.random(), {"alone": draw.random() < 0.4} if kind == LINK_DELETED else {})


def _recipe_check(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    """Everything is written already when the vehicle arms, restarts, falls silent …"""
    yield from _wires(draw, decks, 2)
    yield _stop(draw, next(decks["check"]), Phase.VERIFY)


def _recipe_stop(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    """The vehicle arms, restarts, falls silent … between two parameters."""
    if draw.random() < 0.4:
        yield from _wires(draw, decks, 1)
    yield _stop(draw, next(decks["stop"]), Phase.WRITE)


def _recipe_false(draw: random.Random, decks: dict[str, Iterator[str]], autopilot: str) -> Iterator[Strike]:
    """What is written is not what acts; sometimes the way back is disturbed too."""
    if draw.random() < 0.4:
        yield from _wires(draw, decks, 1)
    kind = next(decks["false"])
    if kind == "not_applied":
        shares = sorted(draw.random() for _ in range(draw.randint(1, 9)))
        yield from (Strike(kind, Phase.WRITE, share) for share in shares)
    elif kind == "foreign_write":
        # An aim of its own: the name of one of the plan's parameters is put in when the plan is known.
        yield Strike(kind, Phase.WRITE, draw.random(), {"aim": draw.random()})
    else:
        yield Strike(kind, Phase.WRITE, draw.random(), {"sensor": OWN, "instance": draw.randint(0, 1)})
    if draw.random() < 0.7:
        yield _stop(draw, next(decks["stop"]), Phase.ROLL_BACK)


def _stop(draw: random.Random, kind: str, phase: Phase) -> Strike:
    options: Json = {}
    if kind == "silence":
        options = {"wall_s": draw.uniform(3.5, 7.0)}
    elif kind == "reboot":
        options = {"flush": draw.random() < 0.5}
    return Strike(kind, phase, draw.random(), options)


_RECIPES = {
    "wire": _recipe_wire,
    "harmless": _recipe_harmless,
    "links": _recipe_links,
    "check": _recipe_check,
    "stop": _recipe_stop,
    "false": _recipe_false,
}
