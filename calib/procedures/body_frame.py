"""Rotates samples into the body frame, where the truth is known, and fits back into the raw sensor's frame.

A fixture, a turntable and a ring turn the body about its own axes, while a fit that is written refers to the raw
sensor. With ``R = body_from_sensor``, ``C_b (R m - b_b)`` seen in the sensor's axes is ``R^T C_b R (m - R^T b_b)``.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from mavcal.calib.fit import AXES, FitResult, FitStatus, parameter_names
from mavcal.calib.recording import Array, Channel, Rounding
from mavcal.calib.triad import TriadModel

_NOTHING = 1e-9  # share of an entry that is rounding


def in_body(channel: Channel, body_from_sensor: Array) -> Channel:
    """The samples along the body's axes; quantisation is kept if every body axis is a sensor axis."""
    if np.array_equal(body_from_sensor, np.eye(3)):
        return channel
    values = channel.values @ body_from_sensor.T
    share = np.abs(body_from_sensor)
    if not np.allclose(share, np.round(share), atol=_NOTHING):
        # every axis is a sum of truncated ones: their errors are noise, which the samples show
        return dataclasses.replace(channel, values=values, quantum=0.0, rounding=Rounding.NONE, zero_bin=None)
    zero_bin = channel.zero_bin
    if zero_bin is not None:
        zero_bin = zero_bin[:, share.argmax(axis=1)]
    return dataclasses.replace(channel, values=values, zero_bin=zero_bin)


def in_sensor(fit: FitResult, body_from_sensor: Array, **changes: Any) -> FitResult:
    """A fit of samples in the body frame as a fit of the raw sensor; `changes` replace other fields.

    `fit` has no thermal part. ``native`` and ``quality`` are unchanged: they refer to the body's axes.
    """
    R = body_from_sensor
    if fit.status == FitStatus.REFUSED or np.array_equal(R, np.eye(3)):
        return dataclasses.replace(fit, **changes)
    turn = np.zeros((12, 12))
    turn[:3, :3] = R.T
    turn[3:, 3:] = np.kron(R.T, R.T)
    opened = _turned_names(fit, R)
    covariance = turn @ fit.covariance @ turn.T
    rows = [parameter_names().index(name) for name in opened]
    covariance[rows, :] = covariance[:, rows] = 0.0
    return dataclasses.replace(
        fit,
        model=TriadModel(R.T @ fit.model.offset, R.T @ fit.model.matrix @ R),
        covariance=0.5 * (covariance + covariance.T),
        undetermined=tuple(opened),
        movements={name: text for name, text in opened.items() if text},
        **changes,
    )


def _turned_names(fit: FitResult, R: Array) -> dict[str, str]:
    """Undetermined parameters in sensor axes: those to which an undetermined one in body axes contributes."""
    found: dict[str, str] = {}
    for name in fit.undetermined:
        text = fit.movements.get(name, "")
        kind, _, axes = name.partition("_")
        i = AXES.index(axes[0])
        reached_i = [a for a in range(3) if abs(R[i, a]) > _NOTHING]
        if kind == "offset":
            found |= {f"offset_{AXES[a]}": text for a in reached_i}
            continue
        reached_j = [b for b in range(3) if abs(R[AXES.index(axes[1]), b]) > _NOTHING]
        found |= {f"matrix_{AXES[a]}{AXES[b]}": text for a in reached_i for b in reached_j}
    return {name: found[name] for name in parameter_names() if name in found}
