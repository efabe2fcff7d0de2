"""Fits of both sensors from the joint solution: units, canonical form, undetermined parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mavcal.calib.fit import AXES, FitBuilder, FitResult, parameter_names
from mavcal.calib.imu.poses import Poses
from mavcal.calib.imu.weighting import MISFIT, GroupFit, Weighed
from mavcal.calib.recording import Array, Channel
from mavcal.calib.stats.norm_fit import PAIRS, symmetric
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel, drift_sd_deg_per_min, tilt_sd_deg

Form = Literal["symmetric", "upper"]

METHOD = "imu-multi"
MOVEMENT = (
    "hold the unit still for two seconds in at least twelve poses: each side down once, the others oblique. "
    "Turn it about another axis each time"
)
EARTH_RATE = 7.292115e-5
"""Turn of the Earth against the stars, rad/s (WGS 84)."""
_FACES = (("nose up", "nose down"), ("left side down", "right side down"), ("upside down", "level"))


@dataclass(frozen=True, eq=False)
class RecordingFacts:
    """Channels and settings that both results share."""

    accel: Channel
    gyro: Channel
    gravity: float
    form: Form
    temperature: float | None
    relative: bool

    def made(self, channel: Channel) -> FitBuilder:
        """Builder of one sensor's result."""
        return FitBuilder.of(METHOD, channel, relative=self.relative, temperature=self.temperature, movement=MOVEMENT)


def imu_refused(facts: RecordingFacts, message: str) -> tuple[FitResult, FitResult]:
    """Refused results of both sensors, with what would determine them."""
    return facts.made(facts.accel).refused(message), facts.made(facts.gyro).refused(message)


def imu_results(
    facts: RecordingFacts,
    poses: Poses,
    weighed: Weighed,
    covariance: Array,
    unknown: NDArray[np.intp],
    *,
    radius: float,
    gyro_scale: float,
    moves_left_out: int,
    misread: float | None = None,
) -> tuple[FitResult, FitResult]:
    """The fits of both sensors, from the solution in radii and scaled rates with its `covariance` (21, 21).

    A gyroscope is refused if `misread` gives a factor on its numbers; the refusal states it.
    """
    x = weighed.solution.x
    spread = _derivative(x, facts, radius, gyro_scale)
    full = spread @ covariance @ spread.T
    full[12:15, 12:15] += np.diag(_earth_variance(poses) / gyro_scale**2)
    models = _models(x, facts, radius, gyro_scale)
    names = _open_names(unknown, facts.form)
    warnings = _warnings(facts, poses, weighed, moves_left_out)
    quality = _quality(poses, weighed, moves_left_out)
    accel = _Part(models[0], full[:12, :12], names[0], warnings, quality)
    gyro = _Part(models[1], full[12:, 12:], names[1], warnings, quality)
    turned = _gyro_fit(facts, poses, weighed, gyro, gyro_scale) if misread is None else _misread(facts, misread)
    return _accel_fit(facts, poses, weighed, accel, radius), turned


@dataclass(frozen=True, eq=False)
class _Part:
    """The solution for one sensor, with its undetermined parameters and common warnings."""

    model: TriadModel
    covariance: Array
    open_names: dict[str, str]
    warnings: tuple[str, ...]
    quality: dict[str, Any]


def _models(x: Array, facts: RecordingFacts, radius: float, gyro_scale: float) -> tuple[TriadModel, TriadModel]:
    """Both models in the units of the sensors and the frame of the chosen form."""
    accel = TriadModel(radius * x[:3], facts.gravity / radius * symmetric(x[3:9]))
    matrix = gyro_scale * x[9:18].reshape(3, 3)
    if facts.form == "upper":
        upper = accel.upper_triangular()
        matrix = upper.matrix @ np.linalg.inv(accel.matrix) @ matrix
        accel = upper
    return accel, TriadModel(x[18:21] / gyro_scale, matrix)


def _derivative(x: Array, facts: RecordingFacts, radius: float, gyro_scale: float) -> Array:
    """Derivative (24, 21) of the numbers of both models by the unknowns, by central differences."""

    def numbers(at: Array) -> Array:
        models = _models(at, facts, radius, gyro_scale)
        return np.concatenate([part for m in models for part in (m.offset, m.matrix.ravel())])

    step = 1e-6
    shifts = step * np.eye(len(x))
    return np.column_stack([(numbers(x + h) - numbers(x - h)) / (2.0 * step) for h in shifts])


def _earth_variance(poses: Poses) -> Array:
    """Variance (3,) of the offset by the Earth's rate, whose direction changes with the pose, (rad/s)^2."""
    weights = 1.0 / poses.rate_variances
    weights = weights / weights.sum(axis=0)
    return np.asarray(EARTH_RATE**2 / 3.0 * (weights**2).sum(axis=0), dtype=np.float64)


def _open_names(unknown: NDArray[np.intp], form: Form) -> tuple[dict[str, str], dict[str, str]]:
    """Undetermined parameters of accelerometer and gyroscope, each with the movement that would determine it."""
    accel: dict[str, str] = {}
    gyro: dict[str, str] = {}
    for index in unknown:
        if index < 6:
            axis = index % 3
            name = f"offset_{AXES[axis]}" if index < 3 else f"matrix_{AXES[axis]}{AXES[axis]}"
            accel[name] = f"hold it {_FACES[axis][0]} and {_FACES[axis][1]}"
        elif index < 9:
            i, j = PAIRS[index - 3]
            for row, column in ((i, j), (j, i))[: 2 if form == "symmetric" else 1]:
                accel[f"matrix_{AXES[row]}{AXES[column]}"] = _oblique(i, j)
        else:
            row, column = divmod(int(index) - 9, 3)
            gyro[f"matrix_{AXES[row]}{AXES[column]}"] = _turning(row, column)
    return accel, gyro


def _oblique(i: int, j: int) -> str:
    return (
        f"hold poses with {AXES[i]} and {AXES[j]} both 45 degrees from vertical, in all four quadrants, "
        f"and turn about {AXES[3 - i - j]} in between"
    )


def _turning(row: int, column: int) -> str:
    if row == column:
        return f"turn it about {AXES[row]} by 90 degrees or more, that axis level, between still poses, both ways"
    return f"turn it about {AXES[column]} by 90 degrees or more with {AXES[row]} level, between still poses, both ways"


def _warnings(facts: RecordingFacts, poses: Poses, weighed: Weighed, moves_left_out: int) -> tuple[str, ...]:
    found = []
    for group, what, extra in (
        (weighed.poses, "poses", weighed.problem.extra[0]),
        (weighed.moves, "movements", weighed.problem.extra[1]),
    ):
        if group.p_value is not None and group.p_value < MISFIT:
            added = (
                f"{facts.gravity * np.sqrt(extra):.2g} m/s2"
                if what == "poses"
                else f"{np.degrees(np.sqrt(extra)):.2g} deg"
            )
            found.append(
                f"the {what} scatter {np.sqrt(group.chi2 / group.dof):.1f} times their noise (sway, non-linearity, "
                f"vibration); {added} each are added to it, and the sd are that much wider"
            )
    left = len(poses) - len(weighed.kept)
    if left:
        spans = [poses.spans[k] for k in range(len(poses)) if k not in weighed.kept]
        listed = ", ".join(f"{start:.1f} to {end:.1f} s" for start, end in spans)
        found.append(f"{left} of {len(poses)} poses contradict the others and were left out: {listed}")
    if moves_left_out:
        found.append(f"{moves_left_out} movements were left out: the gyroscope has holes, is clipped or contradicts")
    if weighed.problem.freedom < 10:
        found.append(f"only {weighed.problem.freedom} residuals more than unknowns: hold more poses to test the fit")
    return tuple(found)


def _quality(poses: Poses, weighed: Weighed, moves_left_out: int) -> dict[str, Any]:
    at = weighed.solution.at
    extra = weighed.problem.extra
    return {
        "poses": len(weighed.kept),
        "poses_left_out": len(poses) - len(weighed.kept),
        "moves": len(weighed.problem.before),
        "moves_left_out": moves_left_out,
        "still_s": float(np.diff(poses.spans, axis=1).sum()),
        "moving_s": float(weighed.problem.moves.durations.sum()),
        "extra_direction_sd_deg": float(np.degrees(np.sqrt(extra[1]))),
        "extra_pose_sd_g": float(np.sqrt(extra[0])),
        "joint_chi2": at.cost,
        "joint_dof": weighed.problem.freedom,
        "spans": poses.spans[weighed.kept].tolist(),
    }


def _statistics(residuals: Array, group: GroupFit) -> dict[str, Any]:
    """Size of the residuals against the sensors' own noise, and their whiteness after weighing."""
    return {
        **residual_statistics(residuals, max(round(group.dof), 0), 1.0),
        "chi2": group.chi2,
        "p_value": group.p_value,
    }


def _accel_fit(facts: RecordingFacts, poses: Poses, weighed: Weighed, part: _Part, radius: float) -> FitResult:
    made = facts.made(facts.accel)
    axes_open = {name[-1] for name in part.open_names if name in _DIRECT}
    if len(axes_open) == 3 or (axes_open and facts.accel.unit != "m/s2"):
        return made.refused(_not_determined("accelerometer", part.open_names))
    corrected = np.linalg.norm(part.model.apply(poses.means[weighed.kept]), axis=1) - facts.gravity
    rms = float(np.sqrt((corrected**2).mean()))
    return made.fitted(
        part.model,
        part.covariance,
        message=_message(weighed, part.open_names),
        n_used=int(poses.counts[weighed.kept].sum()),
        residual_rms=rms * radius / facts.gravity,
        condition_number=_condition(weighed, slice(0, 9)),
        undetermined=part.open_names,
        warnings=part.warnings,
        quality={
            **_statistics(weighed.solution.at.poses, weighed.poses),
            **part.quality,
            "gravity": facts.gravity,
            "norm_rms": rms,
            "pose_residuals": corrected.tolist(),
            "noise_sd": poses.noise_sd,
            "attitude_sd_deg": tilt_sd_deg(part.model, part.covariance, facts.gravity),
        },
        native=_native(part.model, facts.form),
    )


def _misread(facts: RecordingFacts, factor: float) -> FitResult:
    return facts.made(facts.gyro).refused(
        f"the gyroscope reads {1.0 / factor:.2g} times the rate at which gravity turns between the poses: its unit or "
        f"its range is another one; multiply its numbers by {factor:.3g}, or check deg/s, rad/s and full scale",
        movement="state its --unit-gyro",
    )


def _gyro_fit(facts: RecordingFacts, poses: Poses, weighed: Weighed, part: _Part, gyro_scale: float) -> FitResult:
    made = facts.made(facts.gyro)
    scales_open = [name for name in part.open_names if name[-1] == name[-2]]
    if scales_open and facts.gyro.unit != "rad/s":
        return made.refused(_not_determined("gyroscope", part.open_names))
    scales = np.abs(np.linalg.norm(part.model.matrix, axis=0))
    if facts.gyro.unit == "rad/s" and not ((scales > 0.5) & (scales < 2.0)).all():
        factors = ", ".join(f"{1.0 / scale:.3g}" for scale in scales)
        message = f"the gyroscope reads {factors} times the rate about x, y, z: check its unit (deg/s, counts)"
        return made.refused(message, movement="state its --unit-gyro")
    moves = weighed.problem.moves
    closure = _closure(weighed)
    turning = float(np.sqrt((moves.durations**2).mean())) if len(moves) else 1.0
    return made.fitted(
        part.model,
        part.covariance,
        message=_message(weighed, part.open_names),
        n_used=min(
            int(poses.gyro_counts.sum()) + int(np.count_nonzero(moves.steps)), made.n_samples
        ),  # poses and moves share their ends
        residual_rms=closure / turning / gyro_scale,
        condition_number=_condition(weighed, slice(9, 18)),
        undetermined=part.open_names,
        warnings=part.warnings,
        quality={
            **_statistics(weighed.solution.at.moves, weighed.moves),
            **part.quality,
            "closure_rms_deg": float(np.degrees(closure)),
            "noise_sd": np.sqrt(poses.gyro_noise).tolist(),
            "attitude_sd_deg_per_min": drift_sd_deg_per_min(part.model, part.covariance),
        },
        native=_native(part.model, facts.form),
    )


_DIRECT = frozenset(parameter_names()[i] for i in (0, 1, 2, 3, 7, 11))  # offsets and scales


def _not_determined(what: str, names: Iterable[str]) -> str:
    return f"the poses and movements do not determine the {what}'s {', '.join(names)}: {MOVEMENT}"


def _message(weighed: Weighed, open_names: dict[str, str]) -> str:
    fitted = f"fitted to {len(weighed.kept)} poses and {len(weighed.problem.before)} movements between them"
    if not open_names:
        return fitted
    return f"{fitted}; not determined: {', '.join(open_names)}: {next(iter(open_names.values()))}"


def _closure(weighed: Weighed) -> float:
    """Root mean square angle by which the movements miss the next direction, rad."""
    solution, before = weighed.solution, weighed.problem.before
    if not len(before):
        return 0.0
    carried = np.einsum("kij,kj->ki", solution.turns.rotations, solution.directions[before])
    return float(np.sqrt(((carried - solution.directions[before + 1]) ** 2).sum(axis=1).mean()))


def _condition(weighed: Weighed, part: slice) -> float:
    """Condition of the joint information of one sensor's unknowns, each scaled to one."""
    information = weighed.solution.information
    diagonal = np.diag(information)[part]
    on = np.flatnonzero(diagonal > 1e-12 * diagonal.max(initial=0.0)) + part.start
    if not len(on):
        return 0.0
    scale = np.sqrt(np.diag(information)[on])
    return float(np.sqrt(np.linalg.cond(information[np.ix_(on, on)] / np.outer(scale, scale))))


def _native(model: TriadModel, form: Form) -> dict[str, Any]:
    """The model in the form of imu_tk, ``T K (raw - b)``: misalignment T of unit diagonal, scale K, bias b."""
    scale = np.diag(model.matrix)
    native: dict[str, Any] = {
        "offset": model.offset.tolist(),
        "matrix": model.matrix.tolist(),
        "form": form,
        "units_per_si": (1.0 / scale).tolist() if (scale != 0.0).all() else None,
    }
    if (scale != 0.0).all():
        native["imu_tk"] = {
            "misalignment": (model.matrix / scale).tolist(),
            "scale": scale.tolist(),
            "bias": model.offset.tolist(),
        }
    return native
