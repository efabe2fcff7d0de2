"""What every method returns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.recording import Array, Channel, Recording, Sensor, Stage
from mavcal.calib.summary import Summary, counted, spread
from mavcal.calib.triad import TriadModel

if TYPE_CHECKING:
    from mavcal.calib.drawing import Drawing


AXES = "xyz"
OFFSETS = tuple(f"offset_{axis}" for axis in AXES)


class FitStatus(StrEnum):
    """What may be done with a fit."""

    OK = "ok"  # every parameter of the method is determined
    PARTIAL = "partial"  # some parameters are undetermined, by name; the others hold
    REFUSED = "refused"  # nothing of it may be used; the message says why and what would help


def parameter_names(polynomial_degree: int = 0) -> tuple[str, ...]:
    """Names in the order of every covariance: 3 offsets, 9 matrix entries by rows, then axis by axis p1, p2 ...

    >>> parameter_names(1)[:4], parameter_names(1)[-3:]
    (('offset_x', 'offset_y', 'offset_z', 'matrix_xx'), ('poly1_x', 'poly1_y', 'poly1_z'))
    """
    matrix = tuple(f"matrix_{a}{b}" for a in AXES for b in AXES)
    poly = tuple(f"poly{j + 1}_{a}" for a in AXES for j in range(polynomial_degree))
    return OFFSETS + matrix + poly


@dataclass(frozen=True, eq=False)
class FitResult:
    """A sensor model with its uncertainty, and the parameters that the data do not determine.

    `covariance` is square over :func:`parameter_names`; an entry that the method holds fixed, or that is listed in
    `undetermined`, has zero variance there. A symmetric matrix fills both of its halves. With n polynomial terms the
    coefficients follow axis by axis: x p1..pn, y p1..pn, z p1..pn (in natural units about ``polynomial.t_ref``).
    """

    method: str
    sensor: Sensor
    instance: int
    status: FitStatus
    message: str
    model: TriadModel
    covariance: Array
    unit: str
    n_samples: int
    n_used: int
    residual_rms: float
    condition_number: float
    relative: bool = False
    """True: fitted on what was streamed, with the calibration in force unknown; never absolute values."""
    undetermined: tuple[str, ...] = ()
    movements: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))
    """For each of `undetermined`: the movement, or the condition, that would determine it."""
    warnings: tuple[str, ...] = ()
    temperature: float | None = None
    """Mean temperature of the sensor during the fit, degC; None: not known. For thermal fits: t_ref."""
    quality: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """Numbers about the data: coverage, heading error, degrees of freedom, chi2 ... (JSON-able)."""
    native: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """The method's own form, e.g. A and b of accelcal, slopes and intercepts (JSON-able)."""

    def __post_init__(self) -> None:
        covariance = np.array(self.covariance, dtype=np.float64)
        size = len(self.names)
        if covariance.shape != (size, size):
            raise InvalidInputError(f"covariance is {covariance.shape}, the model has {size} parameters")
        if not np.isfinite(covariance).all():
            raise InvalidInputError(f"covariance of {self.method} is not finite; refuse the fit instead")
        unknown = set(self.undetermined) - set(self.names)
        if unknown:
            raise InvalidInputError(f"undetermined names no parameter of the model: {sorted(unknown)}")
        if set(self.movements) - set(self.undetermined):
            raise InvalidInputError(f"movements for what is determined: {sorted(set(self.movements))}")
        object.__setattr__(self, "covariance", covariance)

    @property
    def degree(self) -> int:
        """Number of polynomial terms of the model."""
        return 0 if self.model.polynomial is None else self.model.polynomial.coefficients.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the covariance."""
        return parameter_names(self.degree)

    @property
    def values(self) -> Array:
        """Parameter values in the order of the covariance."""
        poly = self.model.polynomial
        return np.concatenate(
            [self.model.offset, self.model.matrix.ravel(), [] if poly is None else poly.coefficients.ravel()]
        )

    @property
    def sd(self) -> Array:
        """Standard deviations in the order of the covariance; nan where undetermined, 0 where fixed."""
        sd = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        sd[[n in self.undetermined for n in self.names]] = np.nan
        return sd

    def determined(self, *names: str) -> bool:
        """Whether all of `names` may be used."""
        return self.status != FitStatus.REFUSED and not set(names) & set(self.undetermined)

    def corrected_sd(self, truths: Array) -> Array:
        """Standard deviation (N, 3) of the corrected reading at `truths` (N, 3): ``dc = dC C^-1 c - C db``."""
        inner = truths @ np.linalg.inv(self.model.matrix).T
        rows = np.zeros((len(truths), 3, 12))
        rows[:, :, :3] = -self.model.matrix
        for axis in range(3):
            rows[:, axis, 3 + 3 * axis : 6 + 3 * axis] = inner
        variance = np.einsum("nij,jk,nik->ni", rows, self.covariance[:12, :12], rows)
        return np.asarray(np.sqrt(np.clip(variance, 0.0, None)))

    def drift_sd(self, temperatures: Array) -> Array:
        """Standard deviation (N, 3) of the drift about its reference at `temperatures` (N,), degC.

        Raises
        ------
        InvalidInputError
            If the model has no drift.
        """
        curve = self.model.polynomial
        if curve is None:
            raise InvalidInputError(f"{self.method} fits no drift with temperature")
        at, terms = np.asarray(temperatures, dtype=np.float64) - curve.t_ref, self.degree
        powers = np.stack([at ** (k + 1) for k in range(terms)], axis=1)
        blocks = [slice(12 + axis * terms, 12 + (axis + 1) * terms) for axis in range(3)]
        variances = [np.einsum("ij,jk,ik->i", powers, self.covariance[b, b], powers) for b in blocks]
        return np.asarray(np.sqrt(np.clip(np.stack(variances, axis=1), 0.0, None)))

    def plot(self, samples: Channel | Recording | None = None, temperature: ArrayLike | None = None) -> Drawing:
        """Before and after this fit, as a picture that a notebook shows and ``save("fit.svg")`` writes.

        Parameters
        ----------
        samples
            Raw samples of the sensor, usually those of the fit, or a recording that has them: residuals, and what the
            method determines (ellipsoid and sphere, directions, drift, Allan deviation, spectrum). None: what the
            parameters say alone.
        temperature : shape (N,) or None
            Temperature of every sample, degC; only a fit of the drift needs it. None: that of the recording.

        Raises
        ------
        InvalidInputError
            If the fit is refused, or the samples are not raw samples of its sensor.
        """
        if self.status == FitStatus.REFUSED:
            raise InvalidInputError(f"a refused fit has nothing to plot: {self.message}")
        if isinstance(samples, Recording):
            if temperature is None and self.model.polynomial is not None:
                temperature = _temperature_of(samples, self.sensor, self.instance)
            samples = samples.channel(self.sensor, self.instance)
        if samples is not None and samples.stage != Stage.RAW and not self.relative:
            raise InvalidInputError(
                f"these samples of {self.sensor} {self.instance + 1} are {samples.stage}, the fit is of raw ones: "
                "plot mavcal.calib.bare(recording)"
            )
        from mavcal.calib.plots.fit import plotted

        return plotted(self, samples, temperature)

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()

    def _summary(self) -> Summary:
        title = f"{self.method} of {self.sensor} {self.instance + 1}: {self.status}"
        if self.status == FitStatus.REFUSED:
            return Summary(title, notes=(self.message, *self.warnings))
        used = f"{counted(self.n_used)} of {counted(self.n_samples)} samples"
        title += f"; {used}, residual {self.residual_rms:.3g} {self.unit} rms"
        relative = ("relative to the calibration in force, which is not known",) if self.relative else ()
        return Summary(title, ("", *AXES, "unit"), self._rows(), (*relative, *_undetermined(self), *self.warnings))

    def _rows(self) -> tuple[tuple[str, ...], ...]:
        """Offset, matrix and drift with standard deviations; of a noise fit its figures."""
        if "adev" in self.native:
            return tuple(_noise_row(term, self.native) for term in self.native["sd"])
        cells = [spread(float(value), float(sd)) for value, sd in zip(self.values, self.sd, strict=True)]
        rows = [("offset", *cells[:3], self.unit)]
        if self.sd[3:12].any() or not np.array_equal(self.model.matrix, np.eye(3)):
            rows += [(f"matrix {axis}", *cells[3 + 3 * k : 6 + 3 * k], "1") for k, axis in enumerate(AXES)]
        powers = range(self.degree)
        rows += [(f"drift, T^{k + 1}", *cells[12 + k :: self.degree], f"{self.unit}/degC^{k + 1}") for k in powers]
        return tuple(rows)


def _undetermined(fit: FitResult) -> list[str]:
    """What is undetermined, grouped by what would determine it."""
    named: dict[str, list[str]] = {}
    for name in fit.undetermined:
        named.setdefault(fit.movements.get(name, "no remedy is known"), []).append(name)
    return [
        f"undetermined {names[0] if len(names) == 1 else f'{names[0]} to {names[-1]}, {len(names)}'}: {remedy}"
        for remedy, names in named.items()
    ]


def _noise_row(term: str, native: Mapping[str, Any]) -> tuple[str, ...]:
    pairs = zip(native[term], native["sd"][term], strict=True)
    return term, *("not told" if v is None else spread(v, sd or 0.0) for v, sd in pairs), native["unit"][term]


def _temperature_of(recording: Recording, sensor: Sensor, instance: int) -> Array | None:
    """The thermometer of that instance, or the first one, at the times of the sensor's samples; None: there is none."""
    have = recording.instances(Sensor.TEMPERATURE)
    if not have:
        return None
    found = recording.channel(Sensor.TEMPERATURE, instance if instance in have else have[0])
    return np.interp(recording.channel(sensor, instance).t, found.t, found.values[:, 0])


@dataclass(frozen=True)
class FitBuilder:
    """What is known before anything is fitted: the method and the samples.

    It makes the result in one step, fitted or refused, so that none is ever half built.
    """

    method: str
    sensor: Sensor
    instance: int
    unit: str
    n_samples: int
    relative: bool = False
    temperature: float | None = None
    movement: str = ""
    """Movement that would determine the whole model; a refusal without a better one reports it."""

    @classmethod
    def of(
        cls,
        method: str,
        channel: Channel,
        *,
        relative: bool = False,
        temperature: float | None = None,
        movement: str = "",
    ) -> FitBuilder:
        """For the samples of a channel as it was given."""
        return cls(
            method, channel.sensor, channel.instance, channel.unit, len(channel), relative, temperature, movement
        )

    def fitted(
        self,
        model: TriadModel,
        covariance: Array,
        *,
        message: str,
        n_used: int,
        residual_rms: float,
        condition_number: float,
        undetermined: Mapping[str, str] = MappingProxyType({}),
        partial: bool | None = None,
        warnings: Iterable[str] = (),
        quality: Mapping[str, Any] = MappingProxyType({}),
        native: Mapping[str, Any] = MappingProxyType({}),
    ) -> FitResult:
        """The fit; `undetermined` has for each name the movement that would determine it, or nothing.

        `partial` says whether that is less than the method promises; None: whenever something is undetermined.
        """
        lacking = bool(undetermined) if partial is None else partial
        return FitResult(
            method=self.method,
            sensor=self.sensor,
            instance=self.instance,
            status=FitStatus.PARTIAL if lacking else FitStatus.OK,
            message=message,
            model=model,
            covariance=covariance,
            unit=self.unit,
            n_samples=self.n_samples,
            n_used=n_used,
            residual_rms=residual_rms,
            condition_number=condition_number,
            relative=self.relative,
            undetermined=tuple(undetermined),
            movements={name: remedy for name, remedy in undetermined.items() if remedy},
            warnings=tuple(warnings),
            temperature=self.temperature,
            quality=quality,
            native=native,
        )

    def refused(
        self,
        message: str,
        undetermined: tuple[str, ...] = parameter_names(),
        movement: str = "",
        *,
        quality: Mapping[str, Any] = MappingProxyType({}),
    ) -> FitResult:
        """A fit that may not be used: `message` has reason and remedy, `movement` what would determine it."""
        remedy = movement or self.movement
        size = len(parameter_names())
        return FitResult(
            method=self.method,
            sensor=self.sensor,
            instance=self.instance,
            status=FitStatus.REFUSED,
            message=message,
            model=TriadModel(),
            covariance=np.zeros((size, size)),
            unit=self.unit,
            n_samples=self.n_samples,
            n_used=0,
            residual_rms=0.0,
            condition_number=0.0,
            undetermined=undetermined,
            movements=dict.fromkeys(undetermined, remedy) if remedy else {},
            quality=quality,
        )
