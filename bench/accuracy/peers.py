"""Installable programs behind one signature; what is not installed says so by name.

Each answers (offset, shape) of ``y = S u + b``. From a correction ``|A (y - b)| = R`` that is
``S = R (A^T A)^(-1/2)``: this symmetric form is the same for any rotation of A.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Fitted = tuple[Array, Array]

FIELD = 490.0
"""Strength that is told to the programs that want it."""


def shape_of(correction: Array, radius: float = 1.0) -> Array:
    """``R (A^T A)^(-1/2)``."""
    values, vectors = np.linalg.eigh(np.asarray(correction, dtype=np.float64).T @ correction)
    return radius * (vectors / np.sqrt(values)) @ vectors.T


def magcal(samples: Array) -> Fitted:
    module = importlib.import_module("magcal.core")
    found = module.MagnetometerCalibrator().ellipsoid_fit(samples)
    return found["center"], shape_of(found["transform_matrix"])


def magcc_lse(samples: Array) -> Fitted:
    offset, matrix, _, _ = importlib.import_module("magcc.magcc").calibrate_lse(samples, FIELD)
    return offset, shape_of(matrix, FIELD)


def magcc_lm(samples: Array) -> Fitted:
    offset, matrix, _, _ = importlib.import_module("magcc.magcc").calibrate_lm(samples, FIELD)
    return offset, shape_of(matrix, FIELD)


def magyc_ellipsoid(samples: Array) -> Fitted:
    offset, soft_iron, _ = _module_of("magyc", "benchmark_methods/ellipsoidfit.py").ellipsoid_fit(samples)
    inverse = np.linalg.inv(soft_iron)
    return offset, shape_of(inverse, _mean_length(inverse, samples - offset))


def magyc_fang(samples: Array) -> Fitted:
    offset, soft_iron, _ = _module_of("magyc", "benchmark_methods/ellipsoidfit.py").ellipsoid_fit_fang(samples)
    inverse = np.linalg.inv(soft_iron)
    return offset, shape_of(inverse, _mean_length(inverse, samples - offset))


def magyc_twostep(samples: Array) -> Fitted:
    module = _module_of("magyc", "benchmark_methods/twostep.py")
    offset, soft_iron, _ = module.twostep_hsi(samples, np.array([FIELD, 0.0, 0.0]), measurement_noise_std=3.0)
    return np.asarray(offset).ravel(), shape_of(np.linalg.inv(soft_iron), FIELD)


def circuitpython(samples: Array) -> Fitted:
    sensor = importlib.import_module("mag_cal.sensor").Sensor()
    sensor.fit_ellipsoid(samples)
    return np.asarray(sensor.centre).ravel(), shape_of(sensor.transform)


def _mean_length(matrix: Array, vectors: Array) -> float:
    corrected = vectors @ matrix.T
    return float(np.sqrt(np.einsum("ij,ij->i", corrected, corrected)).mean())


def _module_of(package: str, path: str) -> ModuleType:
    """One file of an installed package, without what the rest of it imports."""
    found = importlib.util.find_spec(package)
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError(package)
    name = f"{package}_{Path(path).stem}"
    spec = importlib.util.spec_from_file_location(name, Path(found.submodule_search_locations[0]) / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAGNETOMETER: dict[str, tuple[str, Callable[[Array], Fitted]]] = {
    "magcal ellipsoid": ("magcal", magcal),
    "magcc lse": ("magcc", magcc_lse),
    "magcc lm": ("magcc", magcc_lm),
    "magyc ellipsoid_fit": ("magyc", magyc_ellipsoid),
    "magyc ellipsoid_fit_fang": ("magyc", magyc_fang),
    "magyc twostep_hsi": ("magyc", magyc_twostep),
    "circuitpython-mag-cal": ("circuitpython-mag-cal", circuitpython),
}
"""Name in the tables -> distribution, function."""

DISTRIBUTIONS = ("imucal", "magcc", "magcal", "magyc", "circuitpython-mag-cal", "allantools")


def version_of(distribution: str) -> str | None:
    """The installed version; None: it is not there."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def usable(distribution: str, fit: Callable[[Any], Any], sample: Any) -> str:
    """Why `fit` cannot be measured, from one try on `sample`; empty: it can."""
    if version_of(distribution) is None:
        return "not installed"
    try:
        fit(sample)
    except Exception as error:  # noqa: BLE001 - foreign code; whatever stops it is the answer
        return f"does not run here: {type(error).__name__}: {str(error)[:80]}"
    return ""
