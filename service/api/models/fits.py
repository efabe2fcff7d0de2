"""Fits."""

from __future__ import annotations

from pydantic import BaseModel, Field, computed_field

from mavcal.calib.fit import FitStatus, parameter_names
from mavcal.calib.recording import Sensor
from mavcal.service.api.models.wire import Json, Number, Request


class FitRequest(Request):
    """Fit an uploaded recording."""

    method: str = Field(description="a method of `mavcal fit --help`", examples=["mag-ellipsoid"])
    options: Json = Field(default_factory=dict, description="options of that method")


class FitJobRequest(FitRequest):
    """Fit an uploaded recording as a job."""

    recording: str = Field(description="id of the recording")


class PolynomialModel(BaseModel):
    """How the offset follows the temperature T: the sum over k of coefficients[axis][k-1] * (T - t_ref)^k."""

    # A ThermalPolynomial: its array as rows, no limit as null.
    t_ref: Number = Field(description="degC")
    t_min: Number | None = Field(description="degC; null: without a limit")
    t_max: Number | None = Field(description="degC; null: without a limit")
    coefficients: list[list[Number | None]] = Field(
        description="a row an axis, from the first power on, in the unit of the fit / degC^k; null: not determined"
    )


class SensorModel(BaseModel):
    """corrected = matrix (measured - offset - polynomial(T))."""

    # A TriadModel: its arrays as rows.
    offset: list[Number | None] = Field(description="x y z, in the unit of the fit; null: not determined")
    matrix: list[list[Number | None]] = Field(description="three rows of pure numbers; null: not determined")
    polynomial: PolynomialModel | None


class FitParameterModel(BaseModel):
    """One parameter of a fit."""

    name: str = Field(description="offset_x, matrix_xy, poly1_x ...")
    value: Number | None = Field(description="in `unit`; null: not determined")
    sd: Number | None = Field(description="standard deviation, in `unit`; 0: held fixed; null: not determined")
    unit: str = Field(description="empty: a pure number")


class FitModel(BaseModel):
    """The calibration of one sensor with its uncertainty, and what the data do not say about it."""

    # A FitResult with its standard deviations and a list of its parameters; arrays as rows.
    method: str
    sensor: Sensor
    instance: int = Field(description="which sensor of its kind, from 0")
    status: FitStatus
    message: str
    n_samples: int = Field(description="how many samples were given")
    n_used: int = Field(description="how many of them were used")
    relative: bool = Field(description="fitted on top of a calibration that is not known; never absolute values")
    model: SensorModel
    sd: SensorModel = Field(description="standard deviations in the shape of `model`; 0: held fixed")
    native: Json = Field(description="the method's own form")
    residual_rms: Number | None = Field(description="in `unit`")
    unit: str = Field(description="unit of the offset")
    condition_number: Number | None = Field(
        description="condition number of the problem in scaled unknowns; a pure number"
    )
    undetermined: list[str] = Field(description="names of parameters that the data do not determine")
    movements: dict[str, str] = Field(description="for each of these: the movement that would determine it")
    warnings: list[str]
    quality: Json = Field(description="numbers about the data")
    temperature: Number | None = Field(description="mean temperature of the sensor, degC; null: not known")
    covariance: list[list[Number | None]] = Field(
        description="square, in the order of `parameters` and in products of their units"
    )

    @computed_field(description="every parameter with its value, standard deviation and unit")  # type: ignore[prop-decorator]
    @property
    def parameters(self) -> list[FitParameterModel]:
        """The same numbers as in `model` and `sd`, by name."""
        polynomial = self.model.polynomial
        degree = len(polynomial.coefficients[0]) if polynomial is not None else 0
        units = [self.unit] * 3 + [""] * 9 + [_per_degree(self.unit, k + 1) for _ in "xyz" for k in range(degree)]
        rows = zip(parameter_names(degree), _flat(self.model), _flat(self.sd), units, strict=True)
        return [FitParameterModel(name=name, value=value, sd=sd, unit=unit) for name, value, sd, unit in rows]


def _per_degree(unit: str, power: int) -> str:
    return f"{unit}/degC" if power == 1 else f"{unit}/degC^{power}"


def _flat(model: SensorModel) -> list[Number | None]:
    rows = model.matrix + ([] if model.polynomial is None else model.polynomial.coefficients)
    return [*model.offset, *(value for row in rows for value in row)]


class FitsModel(BaseModel):
    """Fits of an uploaded recording."""

    method: str
    fits: list[FitModel] = Field(description="one a sensor, as in `mavcal fit --json`")
