"""Six faces on a fixture: known directions, so all twelve numbers of an accelerometer (METHODS S4, ``accelcal``).

``C = U A + b`` by rows: least squares of the true face vectors on ``[U 1]``. Tilt of the fixture dominates everything
(0.05 deg leave 6e-4 of cross term), so its size is part of the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2 as chi2_distribution

from calib import STANDARD_GRAVITY
from calib.errors import InvalidInputError
from calib.fit import AXES, FitResult, FitStatus, refused
from calib.recording import Sensor
from calib.triad import TriadModel

Array = NDArray[np.float64]

METHOD = "accel-six-face"
ACCELCAL_GRAVITY = 9.81

Convention = Literal["specific-force", "accelcal"]
CONVENTIONS: tuple[Convention, ...] = ("specific-force", "accelcal")

_SQUARE = np.cos(np.radians(30.0))  # a row farther than this from an axis is no face
_MISFIT = 0.001

_DOWN_AXES = {  # which body axis points down, and with which sign
    "level": (2, 1.0),
    "back": (2, -1.0),
    "left": (1, -1.0),
    "right": (1, 1.0),
    "nose_down": (0, 1.0),
    "nose_up": (0, -1.0),
}
"""MAVLink's ``ACCELCAL_VEHICLE_POS``: lying on its left side, the left side is down."""


@dataclass(frozen=True, eq=False)
class Face:
    """The mean reading of one face.

    `covariance` (3, 3) of the mean is None where only one reading is known. `down` is the unit vector (3,) that points
    down in the sensor's axes; None: recognised from the reading.
    """

    mean: Array
    covariance: Array | None = None
    down: Array | None = None
    n: int = 1


def down_of(label: str) -> Array | None:
    """The direction that is down for a label: a MAVLink pose, or an axis such as ``xup``, ``z_down``, ``+y`` (up).

    None if the label says nothing of the kind.
    """
    name = (
        label.strip().lower().replace("-", "_").replace(" ", "_") if len(label.strip()) > 2 else label.strip().lower()
    )
    if name in _DOWN_AXES:
        axis, sign = _DOWN_AXES[name]
        return np.asarray(sign * np.eye(3)[axis], dtype=np.float64)
    bare = name.replace("_", "")
    for axis, letter in enumerate(AXES):
        if bare in {f"{letter}up", f"+{letter}"}:
            return np.asarray(-np.eye(3)[axis], dtype=np.float64)
        if bare in {f"{letter}down", f"-{letter}"}:
            return np.asarray(np.eye(3)[axis], dtype=np.float64)
    return None


def fit_six_face(
    faces: Sequence[Face],
    *,
    gravity: float | None = None,
    convention: Convention = "specific-force",
    fixture_sd: float = 0.0,
    instance: int = 0,
    unit: str = "m/s2",
    temperature: float | None = None,
    relative: bool = False,
) -> FitResult:
    """Offset and full matrix of an accelerometer from faces of a fixture.

    Parameters
    ----------
    faces
        Face means (best: single noisy samples shrink the answer), or single readings; every axis up and down.
    gravity : float or None
        In m/s2 or in g. None: 1 or the gravity of the convention (9.80665; accelcal: 9.81), whichever is nearer to
        the readings.
    convention
        ``specific-force``: level, z reads -g. ``accelcal``: the axis that points down reads +g.
    fixture_sd : float
        Standard deviation of each face's tilt about each horizontal axis, degrees; part of the covariance.
    instance, unit, temperature, relative
        Passed on to the result.

    Returns
    -------
    FitResult
        ``native`` holds A (3, 3) and b (3,) of ``C = U A + b``, gravity and convention. The model is the same
        correction: ``matrix = A^T``, ``offset = -A^-T b``, in the convention of the readings.
    """
    if convention not in CONVENTIONS:
        raise InvalidInputError(f"the convention is one of {', '.join(CONVENTIONS)}, not {convention!r}")
    if not (np.isfinite(fixture_sd) and fixture_sd >= 0.0):
        raise InvalidInputError(f"the tilt of the fixture is a number of degrees, not {fixture_sd}")
    n_samples = sum(face.n for face in faces)

    def refusal(message: str) -> FitResult:
        return refused(METHOD, Sensor.ACCEL, instance, message, unit=unit, n_samples=n_samples)

    U = np.array([face.mean for face in faces], dtype=np.float64).reshape(-1, 3)
    if len(U) < 6 or not np.isfinite(U).all():
        return refusal(f"{len(U)} faces with finite readings: six are needed, every axis once up and once down")
    sign = 1.0 if convention == "accelcal" else -1.0
    directions, problem = _directions(faces, U, sign)
    if problem:
        return refusal(problem)
    g = _gravity(U, gravity, convention, unit)
    if g is None:
        size = float(np.linalg.norm(U, axis=1).mean())
        return refusal(f"readings of length {size:.4g} {unit} are neither g nor m/s2: state --gravity or the unit")
    return _fitted(faces, U, g * sign * directions, g, convention, fixture_sd, instance, unit, temperature, relative)


def _directions(faces: Sequence[Face], U: Array, sign: float) -> tuple[Array, str]:
    """Unit vectors (K, 3) that point down, and what is wrong with them; empty if nothing is."""
    centred = U - 0.5 * (U.max(axis=0) + U.min(axis=0))
    directions = np.zeros_like(U)
    for k, face in enumerate(faces):
        axis = int(np.argmax(np.abs(centred[k])))
        seen = np.sign(centred[k, axis]) * np.eye(3)[axis] * sign
        if abs(centred[k, axis]) < _SQUARE * np.linalg.norm(centred[k]):
            return directions, f"reading {k + 1} ({_listed(U[k])}) lies between the axes: hold every face square"
        if face.down is not None and not np.array_equal(face.down, seen):
            if np.array_equal(face.down, -seen):
                return directions, (
                    f"reading {k + 1} has the sign of the other convention: one of {' and '.join(CONVENTIONS)} "
                    "must be stated rightly"
                )
            return directions, f"reading {k + 1} ({_listed(U[k])}) is not the face that its label says"
        directions[k] = seen
    missing = [
        f"{AXES[axis]} {'down' if side > 0 else 'up'}"
        for axis in range(3)
        for side in (-1.0, 1.0)
        if not (directions[:, axis] == side).any()
    ]
    return directions, f"no face with {', '.join(missing)}: turn it there" if missing else ""


def _gravity(U: Array, gravity: float | None, convention: Convention, unit: str) -> float | None:
    if gravity is not None:
        if not (np.isfinite(gravity) and gravity > 0.0):
            raise InvalidInputError(f"gravity must be positive, not {gravity}")
        return gravity
    size = float(np.linalg.norm(U, axis=1).mean())
    standard = ACCELCAL_GRAVITY if convention == "accelcal" else STANDARD_GRAVITY
    nearest = min((standard, 1.0), key=lambda g: abs(size - g))
    return nearest if 0.5 * nearest < size < 2.0 * nearest else None


def _fitted(
    faces: Sequence[Face],
    U: Array,
    T: Array,
    g: float,
    convention: Convention,
    fixture_sd: float,
    instance: int,
    unit: str,
    temperature: float | None,
    relative: bool,
) -> FitResult:
    X = np.column_stack([U, np.ones(len(U))])
    solution = np.linalg.lstsq(X, T, rcond=None)[0]
    A, b = np.asarray(solution[:3]), np.asarray(solution[3])
    residual = np.asarray(T - X @ solution, dtype=np.float64)
    dof = 3 * (len(U) - 4)
    H = np.linalg.pinv(X)  # (4, K): solution = H T
    errors = _Errors.of(faces, A, T, g, fixture_sd, residual, dof)
    spread = errors.spread(H)
    chi2 = errors.chi2(residual, T / g) if errors.predicted else None
    jacobian, model = _model_jacobian(A, b)
    covariance = jacobian @ spread @ jacobian.T
    warnings = []
    p_value = None if chi2 is None else float(chi2_distribution.sf(chi2, dof))
    if p_value is not None and p_value < _MISFIT and chi2 is not None:
        covariance = covariance * (chi2 / dof)
        warnings.append(
            f"the faces disagree more than noise and a tilt of {fixture_sd} deg explain (p = {p_value:.1e}; the sd is "
            "inflated to their scatter): the fixture is worse, or a face was disturbed"
        )
    return FitResult(
        method=METHOD,
        sensor=Sensor.ACCEL,
        instance=instance,
        status=FitStatus.OK,
        message=f"fitted to {len(U)} readings of six faces, gravity {g:g}",
        model=model,
        covariance=0.5 * (covariance + covariance.T),
        unit=unit,
        n_samples=sum(face.n for face in faces),
        n_used=sum(face.n for face in faces),
        residual_rms=float(np.sqrt((residual**2).mean())),
        condition_number=float(np.linalg.cond(X / np.linalg.norm(X, axis=0))),
        relative=relative,
        warnings=tuple(warnings),
        temperature=temperature,
        quality={"chi2": chi2, "dof": dof, "p_value": p_value, "faces": len(U), "gravity": g},
        native={
            "A": A.tolist(),
            "b": b.tolist(),
            "gravity": g,
            "convention": convention,
            "form": "C = U A + b by rows",
        },
    )


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of the rows of the regression: noise of each reading, and a tilt that all readings of a face share."""

    noise: Array  # (K, 3, 3) in the corrected unit
    tilt: Array  # (6, 3, 3): across gravity, g^2 sd^2 (I - t t^T)
    members: Array  # (6, K): which readings are of which face
    predicted: bool  # False: the residuals themselves had to tell the noise

    @classmethod
    def of(
        cls, faces: Sequence[Face], A: Array, T: Array, g: float, fixture_sd: float, residual: Array, dof: int
    ) -> _Errors:
        ways = np.vstack([np.eye(3), -np.eye(3)])
        members = (ways @ T.T > 0.5 * g).astype(np.float64)
        tilt = (g * np.radians(fixture_sd)) ** 2 * (np.eye(3) - ways[:, :, None] * ways[:, None, :])
        known = [face.covariance for face in faces if face.covariance is not None]
        if len(known) < len(faces):
            scatter = float((residual**2).sum()) / dof
            return cls(np.tile(scatter * np.eye(3), (len(T), 1, 1)), tilt, members, predicted=False)
        floor = (1e-9 * g) ** 2 * np.eye(3)  # exact numbers keep a weight
        noise = np.einsum("ia,kij,jb->kab", A, np.array(known), A) + floor
        return cls(noise, tilt, members, predicted=True)

    def spread(self, H: Array) -> Array:
        """Covariance (12, 12) of ``H`` (4, K) times the rows, row by row."""
        by_face = H @ self.members.T
        shared = np.einsum("af,bf,fij->aibj", by_face, by_face, self.tilt)
        own = np.einsum("ak,bk,kij->aibj", H, H, self.noise)
        return np.asarray((own + shared).reshape(12, 12), dtype=np.float64)

    def chi2(self, residual: Array, directions: Array) -> float:
        """Squared residuals in units of their own covariance, over what four columns leave of the rows."""
        X = np.column_stack([directions, np.ones(len(residual))])
        values, vectors = np.linalg.eigh(np.eye(len(X)) - X @ np.linalg.pinv(X))
        basis = vectors[:, values > 0.5]  # (K, K-4)
        by_face = basis.T @ self.members.T
        own = np.einsum("kp,kq,kij->piqj", basis, basis, self.noise)
        shared = np.einsum("pf,qf,fij->piqj", by_face, by_face, self.tilt)
        r = (basis.T @ residual).ravel()
        return float(r @ np.linalg.solve((own + shared).reshape(len(r), len(r)), r))


def _model_jacobian(A: Array, b: Array) -> tuple[Array, TriadModel]:
    """Derivative of the model's twelve numbers by ``[A; b]`` (rows), and the model."""
    inverse = np.linalg.inv(A)  # offset^T = -b^T A^-1
    model = TriadModel(offset=-b @ inverse, matrix=A.T)
    jacobian = np.zeros((12, 12))
    jacobian[:3, 9:] = -inverse.T
    for i in range(3):
        for j in range(3):
            jacobian[3 + 3 * j + i, 3 * i + j] = 1.0
            jacobian[:3, 3 * i + j] = (b @ inverse)[i] * inverse[j]
    return jacobian, model


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.4g}" for value in values)
