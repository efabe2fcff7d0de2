"""Six faces on a fixture: directions are known, which determines all 12 parameters (METHODS S4, ``accelcal``).

``C = U A + b`` by rows: least squares of the true face vectors on ``[U 1]``, as published. The noisy readings are the
regressors, so single samples shrink the matrix by ``1 + 3 s^2/g^2``; face means do not. The forward form ``U = t M^T +
b`` has no such bias. Half the difference of two faces is a column of M, as with six rings. Tilt of the fixture
dominates everything (0.05 deg leave 6e-4 of cross term), so its size is part of the covariance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy

from mavcal.calib.accel.faces import CONVENTIONS, Convention, Face, directions_of, recognised_gravity
from mavcal.calib.c_array import homogeneous
from mavcal.calib.conventions import accelcal_from_model
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitBuilder, FitResult
from mavcal.calib.recording import Array, Sensor
from mavcal.calib.stats.residuals import residual_statistics
from mavcal.calib.triad import TriadModel, tilt_sd_deg

METHOD = "accel-six-face"
Form = Literal["accelcal", "forward"]
FORMS: tuple[Form, ...] = ("accelcal", "forward")

_MISFIT = 0.001
_ALL_FACES = "hold it on each of its six sides in turn, square on the fixture: every axis once up and once down"
_MOST_CONDITION = 1e6
_FACES = 6
_NOTICEABLE = 0.2  # of its sd, a shrink of the scale that is worth a warning


def fit_six_face(
    faces: Sequence[Face],
    *,
    gravity: float | None = None,
    convention: Convention = "specific-force",
    form: Form = "accelcal",
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
        Face means, or single readings, whose noise shrinks the matrix; every axis up and down.
    gravity : float or None
        In m/s2 or in g. None: 1 or the gravity of the convention (9.80665; accelcal: 9.81), whichever is nearer to
        the readings.
    convention
        ``specific-force``: level, z reads -g. ``accelcal``: the axis that points down reads +g.
    form
        ``accelcal``: the published regression of the true vectors on the readings. ``forward``: of the readings on the
        true vectors, which noise does not bias.
    fixture_sd : float
        Standard deviation of each face's tilt about each horizontal axis, degrees; part of the covariance.
    instance, unit, temperature, relative
        Passed on to the result.

    Returns
    -------
    FitResult
        ``native`` holds A (3, 3) and b (3,) of ``C = U A + b``. It also holds the columns of the sensitivity, which
        with the offset are the forward form. The homogeneous 4 x 4 matrix, gravity and convention follow. The model is
        the same correction: ``matrix = A^T``, ``offset = -A^-T b``, in the convention of the readings.

    Raises
    ------
    InvalidInputError
        If an option is impossible.
    """
    if form not in FORMS:
        raise InvalidInputError(f"the form is one of {', '.join(FORMS)}, not {form!r}")
    if convention not in CONVENTIONS:
        raise InvalidInputError(f"the convention is one of {', '.join(CONVENTIONS)}, not {convention!r}")
    if not (np.isfinite(fixture_sd) and fixture_sd >= 0.0):
        raise InvalidInputError(f"the tilt of the fixture is a number of degrees, not {fixture_sd}")
    n_samples = sum(face.n for face in faces)
    made = FitBuilder(METHOD, Sensor.ACCEL, instance, unit, n_samples, relative, temperature, _ALL_FACES)
    U = np.array([face.mean for face in faces], dtype=np.float64).reshape(-1, 3)
    if len(U) < 6 or not np.isfinite(U).all():
        return made.refused(f"{len(U)} faces with finite readings: six are needed, every axis once up and once down")
    sign = 1.0 if convention == "accelcal" else -1.0
    directions, problem = directions_of(faces, U, sign)
    if problem:
        return made.refused(problem)
    g = recognised_gravity(U, gravity, convention)
    if g is None:
        size = float(np.linalg.norm(U, axis=1).mean())
        message = f"readings of length {size:.4g} {unit} are neither g nor m/s2: state --gravity or the unit"
        return made.refused(message, movement="state the length of gravity in the unit of the samples, or their unit")
    rows = _Rows(tuple(faces), U, g * sign * directions, g, fixture_sd)
    if np.linalg.cond(_regressors(rows, form)) > _MOST_CONDITION:
        return made.refused(
            "the readings of opposite faces do not differ: the accelerometer is stuck, or was not turned"
        )
    return _fitted(made, rows, convention, form)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Readings U (K, 3) of faces whose true vectors are T (K, 3), all of them g long."""

    faces: tuple[Face, ...]
    U: Array
    T: Array
    g: float
    fixture_sd: float


def _regressors(rows: _Rows, form: Form) -> Array:
    """Columns of the regression, each of the order of one: ``[U 1]``, or ``[T 1]`` for the forward form."""
    known = rows.U / np.abs(rows.U).max() if form == "accelcal" else rows.T / rows.g
    return np.column_stack([known, np.ones(len(known))])


def _fitted(made: FitBuilder, rows: _Rows, convention: Convention, form: Form) -> FitResult:
    forward = form == "forward"
    left, right = (rows.T, rows.U) if forward else (rows.U, rows.T)
    X = np.column_stack([left, np.ones(len(left))])
    H = np.linalg.pinv(X)  # (4, K): solution = H right
    solution = np.asarray(H @ right if forward else np.linalg.lstsq(X, right, rcond=None)[0], dtype=np.float64)
    residual = np.asarray(right - X @ solution, dtype=np.float64)
    dof = 3 * (len(X) - 4)
    errors = _Errors.of(rows, np.eye(3) if forward else solution[:3], solution[:3] if forward else np.eye(3), residual)
    jacobian, model = _forward_jacobian(solution) if forward else _model_jacobian(solution[:3], solution[3])
    covariance = jacobian @ errors.spread(H) @ jacobian.T
    chi2 = errors.chi2(residual, rows.T / rows.g) if errors.predicted else None
    p_value = None if chi2 is None else float(scipy.special.chdtrc(dof, chi2))
    warnings = []
    if p_value is not None and p_value < _MISFIT and chi2 is not None:
        covariance = covariance * (chi2 / dof)
        warnings.append(
            f"the faces disagree more than noise and a tilt of {rows.fixture_sd} deg explain (p = {p_value:.1e}; the "
            "sd is inflated to their scatter): the fixture is worse, or a face was disturbed"
        )
    corrected = rows.T - model.apply(rows.U)
    if not forward:
        warnings += _shrinks(rows, corrected, dof, float(np.sqrt(np.diag(covariance)[[3, 7, 11]].min())))
    return made.fitted(
        model,
        0.5 * (covariance + covariance.T),
        message=f"fitted to {len(X)} readings of six faces, gravity {rows.g:g}",
        n_used=made.n_samples,
        residual_rms=float(np.sqrt((corrected**2).mean())),
        condition_number=float(np.linalg.cond(X / np.linalg.norm(X, axis=0))),
        warnings=warnings,
        quality={
            **residual_statistics(corrected, dof, None),
            "chi2": chi2,
            "dof": dof,
            "p_value": p_value,
            "faces": len(X),
            "gravity": rows.g,
            "fixture_sd_deg": rows.fixture_sd,
            "attitude_sd_deg": tilt_sd_deg(model, covariance, rows.g),
        },
        native=_native(model, rows, convention, form),
    )


def _native(model: TriadModel, rows: _Rows, convention: Convention, form: Form) -> dict[str, Any]:
    A, b = accelcal_from_model(model)
    return {
        "A": A.tolist(),
        "b": b.tolist(),
        "columns": np.linalg.inv(model.matrix).tolist(),
        "offset": model.offset.tolist(),
        "homogeneous": homogeneous(model.matrix, model.offset).tolist(),
        "gravity": rows.g,
        "convention": convention,
        "regression": form,
        "form": "C = U A + b by rows",
    }


def _shrinks(rows: _Rows, residual: Array, dof: int, sd: float) -> list[str]:
    """A warning if noisy regressors shrink the matrix, by ``3 s^2/g^2`` for single readings of noise s (METHODS S4)."""
    if all(face.covariance is not None for face in rows.faces) or len(rows.faces) <= _FACES:
        return []
    shrink = 3.0 * float((residual**2).sum()) / dof / rows.g**2
    if shrink < _NOTICEABLE * sd:
        return []
    return [
        f"single noisy samples stand on the known side of the regression: the matrix is too small by {shrink:.1e} "
        f"({shrink / sd:.1f} of its sd); use --samples means, or --form forward"
    ]


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of the rows of the regression: noise of each reading, and a tilt that all readings of a face share."""

    noise: Array  # (K, 3, 3) in the unit of the regressed side
    tilt: Array  # (6, 3, 3): across gravity, g^2 sd^2 (I - t t^T), in the same
    members: Array  # (6, K): the readings of each face
    predicted: bool  # False: the residuals themselves had to tell the noise

    @classmethod
    def of(cls, rows: _Rows, readings: Array, truths: Array, residual: Array) -> _Errors:
        """Errors of `rows`; `readings` and `truths` (3, 3) map errors of readings and true vectors to the residual."""
        ways = np.vstack([np.eye(3), -np.eye(3)])
        members = (ways @ rows.T.T > 0.5 * rows.g).astype(np.float64)
        across = np.eye(3) - ways[:, :, None] * ways[:, None, :]
        tilt = (rows.g * np.radians(rows.fixture_sd)) ** 2 * np.einsum("ia,fij,jb->fab", truths, across, truths)
        known = [face.covariance for face in rows.faces if face.covariance is not None]
        if len(known) < len(rows.faces):
            scatter = float((residual**2).sum()) / (3 * (len(residual) - 4))
            return cls(np.tile(scatter * np.eye(3), (len(residual), 1, 1)), tilt, members, predicted=False)
        floor = (1e-9 * float(np.abs(rows.U).max())) ** 2 * np.eye(3)  # exact numbers keep a weight
        noise = np.einsum("ia,kij,jb->kab", readings, np.array(known) + floor, readings)
        return cls(noise, tilt, members, predicted=True)

    def spread(self, H: Array) -> Array:
        """Covariance (12, 12) of the solution ``H Y`` by rows, with H (4, K) and the regressed Y (K, 3)."""
        by_face = H @ self.members.T
        shared = np.einsum("af,bf,fij->aibj", by_face, by_face, self.tilt)
        own = np.einsum("ak,bk,kij->aibj", H, H, self.noise)
        return np.asarray((own + shared).reshape(12, 12), dtype=np.float64)

    def chi2(self, residual: Array, directions: Array) -> float:
        """Chi-square of the residuals in the subspace orthogonal to the four regressors, with their full covariance."""
        X = np.column_stack([directions, np.ones(len(residual))])
        values, vectors = np.linalg.eigh(np.eye(len(X)) - X @ np.linalg.pinv(X))
        basis = vectors[:, values > 0.5]  # (K, K-4)
        by_face = basis.T @ self.members.T
        own = np.einsum("kp,kq,kij->piqj", basis, basis, self.noise)
        shared = np.einsum("pf,qf,fij->piqj", by_face, by_face, self.tilt)
        r = (basis.T @ residual).ravel()
        return float(r @ np.linalg.solve((own + shared).reshape(len(r), len(r)), r))


def _model_jacobian(A: Array, b: Array) -> tuple[Array, TriadModel]:
    """Derivative (12, 12) of the model's parameters by ``[A; b]`` (rows), and the model."""
    inverse = np.linalg.inv(A)  # offset^T = -b^T A^-1
    model = TriadModel(offset=-b @ inverse, matrix=A.T)
    jacobian = np.zeros((12, 12))
    jacobian[:3, 9:] = -inverse.T
    for i in range(3):
        for j in range(3):
            jacobian[3 + 3 * j + i, 3 * i + j] = 1.0
            jacobian[:3, 3 * i + j] = (b @ inverse)[i] * inverse[j]
    return jacobian, model


def _forward_jacobian(solution: Array) -> tuple[Array, TriadModel]:
    """Derivative (12, 12) of the model's parameters by ``[M^T; b]`` (rows), and the model: ``dC = -C dM C``."""
    matrix = np.asarray(np.linalg.inv(solution[:3].T), dtype=np.float64)
    jacobian = np.zeros((12, 12))
    jacobian[:3, 9:] = np.eye(3)
    for i in range(3):
        for j in range(3):  # solution[j, i] = M[i, j]
            jacobian[3:, 3 * j + i] = -np.outer(matrix[:, i], matrix[j]).ravel()
    return jacobian, TriadModel(offset=solution[3], matrix=matrix)
