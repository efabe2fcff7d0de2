"""Errors of the predicted flight: velocity and body rate from measured starts, before and after each effect.

Velocity follows from a force through the measured attitude, body rate from a torque. The floor is the same rollout with
the measured force or torque: it integrates only errors of sensors and estimator.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import Quantity, Rollout, RolloutStep
from mavcal.calib.airframe.physics import Airframe

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

VELOCITY_HORIZONS_S: Final = (0.5, 1.0, 2.0)
RATE_HORIZONS_S: Final = (0.1, 0.2)
"""Horizons of the predictions, s. Source: AIRFRAME 5.5."""
BLOCK_S: Final = 10.0
"""Length of the stretches that are held out in turn, s. Source: AIRFRAME 5.7."""
_EVERY_S: Final = 0.25
_RESAMPLED: Final = 200
_LEAST: Final = 20
_WIDEST: Final = 1.0
_PLAIN: Final = 2
"""Number of error rows without an added effect: the simulator's own, and the floor."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Force and torque (N, 3) of one airframe at the flight's commands; `add` is the effect that was added last."""

    add: str
    force: Array
    torque: Array


def folds(airframe: Airframe) -> tuple[Mask, Mask]:
    """Masks (N,) of alternate stretches of the flight: each is held out once."""
    t = airframe.flight.t
    odd = ((t - t[0]) // BLOCK_S).astype(int) % 2 == 1
    return odd, ~odd


def rollouts(
    airframe: Airframe,
    held_out: Sequence[tuple[Mask, Sequence[Predicted]]],
    *,
    torque: bool,
    part: str = "blocks",
) -> tuple[Rollout, ...]:
    """Errors on held-out rows.

    Parameters
    ----------
    airframe
        Of the real flight.
    held_out
        For each fold its rows (N,), and the predictions of airframes fitted without them: the simulator's, then each
        with one more effect.
    torque
        Whether body rates are predicted.
    part
        What was held out.
    """
    made = []
    for horizon in VELOCITY_HORIZONS_S:
        made.append(_one(airframe, held_out, horizon, Quantity.VELOCITY, part))
    for horizon in RATE_HORIZONS_S if torque else ():
        made.append(_one(airframe, held_out, horizon, Quantity.BODY_RATE, part))
    return tuple(m for m in made if m is not None)


def _one(
    airframe: Airframe,
    held_out: Sequence[tuple[Mask, Sequence[Predicted]]],
    horizon: float,
    quantity: Quantity,
    part: str,
) -> Rollout | None:
    flight = airframe.flight
    of_velocity = quantity is Quantity.VELOCITY
    unit = "m/s" if of_velocity else "rad/s"
    error: Callable[[Array, Array], Array] = _velocity_error(airframe) if of_velocity else _rate_error(airframe)
    steps, every = round(horizon * flight.fs), round(_EVERY_S * flight.fs)
    force, torque = airframe.measured
    rows: list[Array] = []
    for kept, predictions in held_out:
        good = kept & flight.usable
        starts = np.arange(0, len(flight.t) - steps - 1, every)
        whole = np.concatenate([[0], np.cumsum(~good)])
        starts = starts[whole[starts + steps + 1] == whole[starts]]
        signals = [*((p.force if of_velocity else p.torque) for p in predictions), force if of_velocity else torque]
        rows.append(np.array([error(s, np.stack([starts, starts + steps])) for s in signals]))
    errors = np.concatenate(rows, axis=1) if rows else np.empty((0, 0))
    if errors.shape[1] < _LEAST:
        return None
    rms = np.sqrt(errors.mean(axis=1))
    closed, ci95 = _closed(errors)
    names = [p.add for p in held_out[0][1]][1:]
    sequence = tuple(RolloutStep(name, float(r)) for name, r in zip(names, rms[1:-1], strict=True))
    return Rollout(horizon, quantity, unit, float(rms[0]), float(rms[-2]), float(rms[-1]), closed, ci95, part, sequence)


def _closed(errors: Array) -> tuple[float | None, tuple[float, float] | None]:
    """Fraction of the error above the floor that is closed, from squared errors (models, starts), and its interval."""

    def share(some: Array) -> float:
        before, after, floor = np.sqrt(some[[0, -2, -1]].mean(axis=1))
        return float((before - after) / (before - floor)) if before > floor * 1.02 else float("nan")

    whole = share(errors) if len(errors) > _PLAIN else float("nan")
    if not np.isfinite(whole):
        return None, None
    rng = np.random.default_rng(0)
    count = errors.shape[1]
    groups = np.array_split(np.arange(count), max(count // 8, 2))
    drawn = []
    for _ in range(_RESAMPLED):
        picked = np.concatenate([groups[k] for k in rng.integers(0, len(groups), len(groups))])
        drawn.append(share(errors[:, picked]))
    low, high = np.nanpercentile(drawn, (2.5, 97.5))
    if not (np.isfinite(low) and np.isfinite(high)) or high - low > _WIDEST:
        return whole, None
    return whole, (float(low), float(high))


def _velocity_error(airframe: Airframe) -> Callable[[Array, Array], Array]:
    flight, body = airframe.flight, airframe.body_from_local
    down = np.array([0.0, 0.0, flight.gravity])

    def squared(force: Array, ends: Array) -> Array:
        local = np.einsum("nji,nj->ni", body, np.nan_to_num(force)) + down
        speed = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (local[1:] + local[:-1]), axis=0) / flight.fs])
        gone = (speed[ends[1]] - speed[ends[0]]) - (flight.velocity[ends[1]] - flight.velocity[ends[0]])
        return np.asarray((gone**2).sum(axis=1))

    return squared


def _rate_error(airframe: Airframe) -> Callable[[Array, Array], Array]:
    flight = airframe.flight

    def squared(torque: Array, ends: Array) -> Array:
        clean = np.nan_to_num(torque)
        rate = np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * (clean[1:] + clean[:-1]), axis=0) / flight.fs])
        gone = (rate[ends[1]] - rate[ends[0]]) - (flight.rate[ends[1]] - flight.rate[ends[0]])
        return np.asarray((gone**2).sum(axis=1))

    return squared
