"""The report of a gap diagnosis, and its JSON ("gap/1").

Parameters are forward: added to, or multiplying, the ideal reading. Numbers in the JSON are finite or null.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from cattrs import Converter
from cattrs.gen import make_dict_unstructure_fn, override
from numpy.typing import NDArray

from mavcal.calib.airframe.answer import AirframePart, Domain
from mavcal.calib.converter import make_converter
from mavcal.calib.recording import Sensor
from mavcal.calib.summary import Summary

if TYPE_CHECKING:
    from mavcal.calib.drawing import Drawing

Array = NDArray[np.float64]
Json = dict[str, Any]

SCHEMA = "gap/1"
EVEN = 0.5
"""Probability above which an effect is likelier than all alternatives together. Source: even odds."""
USELESS_DEG = 3.0
"""Standard deviation of a re-estimated attitude, degrees, above which no sensor is judged by it. A tilt of it reads
like 0.5 m/s2 of an accelerometer and 2.6 uT of a compass in a field of 50 uT. Source: decision 32."""
REFERENCE_NEED = (
    "a recording that speeds up, brakes and turns through all headings with GPS velocity, a compass and an inertial "
    "unit faster than 10 Hz; or --sim of the same trajectory; or a measured pose (q_* or ref_q_* columns)"
)
"""Advice on how to get a better reference."""
RE_ESTIMATED = "estimator"
"""Kind of the reference that is made from the recording itself."""
FIRST = 1
"""Instances count from 1 in a report. Source: GAP 8."""


class GapVerdict(StrEnum):
    """The verdict of a diagnosis."""

    EXPLAINED = "explained"  # effects of the catalogue account for the gap
    PARTLY_EXPLAINED = "partly_explained"  # they account for part of it, and the rest is not of the catalogue
    UNKNOWN = "unknown"  # there is a gap, and no effect of the catalogue explains it
    REFERENCE = "reference"  # what differs is the reference, or it is known too badly to judge a sensor by it
    NO_GAP = "no_gap"  # nothing beyond the noise
    NOT_TESTABLE = "not_testable"  # these recordings do not allow an answer


@dataclass(frozen=True)
class Regime:
    """A condition: one bin of one covariate. `kind` is ``all time temperature current ... band``."""

    kind: str
    bin: tuple[float, float]
    unit: str = ""


@dataclass(frozen=True)
class LocatedGap:
    """A channel in a regime in which the sensor differs from its reference by more than the noise.

    `nats_per_sample` is the loss of log-likelihood against the declared noise; `p_holm` is corrected for the number of
    cells.
    """

    channel: str
    instance: int
    regime: Regime
    nats_per_sample: float
    rms: float
    unit: str
    p_holm: float


@dataclass(frozen=True)
class ParameterEstimate:
    """One parameter of an effect with its standard error and 95 % interval."""

    name: str
    value: float
    se: float
    ci95: tuple[float, float]
    unit: str
    value_real: float | None = None
    value_sim: float | None = None
    """Values of both flights, where both were fitted with a model; they may share a bias that cancels in the ratio."""
    ratio: float | None = None
    ratio_ci95: tuple[float, float] | None = None
    """Ratio real over simulated, the result for an airframe effect."""


@dataclass(frozen=True)
class EffectEvidence:
    """Evidence of an effect.

    `share` is its part of the common gain of all effects, from the mean of its gain as the first and as the last one.
    """

    two_delta_loglik: float
    df: int
    p_adj: float
    probability: float
    share: float

    @property
    def doubtful(self) -> bool:
        """Whether an alternative is likelier: a rival, another instance, or an unnamed cause."""
        return self.probability < EVEN


@dataclass(frozen=True)
class Rival:
    """Another explanation of the same data.

    `kappa` is the share of the effect's energy that it can imitate, `delta` the penalised evidence (twice the
    log-likelihood) for the effect against it, and `fix` a recording that would separate them.
    """

    id: str
    kappa: float
    delta: float
    fix: str


@dataclass(frozen=True)
class Gates:
    """Results of the checks of an effect; None where a check could not be made."""

    heldout_blocks: bool | None = None
    other_log: bool | None = None
    dose_response: bool | None = None


@dataclass(frozen=True)
class EffectEstimate:
    """An effect that was found. Instances count from 1; those of a weak motor are motors.

    `sensor` is None where no sensor is wrong: `domain` says airframe or environment. `sim_patch` has the simulator's
    parameter names; tables of a file are under ``frame_json`` and ``sdf``.
    """

    id: str
    sensor: Sensor | None
    instances: tuple[int, ...]
    params: tuple[ParameterEstimate, ...]
    evidence: EffectEvidence
    confusable_with: tuple[Rival, ...] = ()
    gates: Gates = Gates()
    sim_patch: Mapping[str, Any] = field(default_factory=dict)
    domain: Domain = Domain.SENSOR
    forms: Mapping[str, float] = field(default_factory=dict)
    """Probability of each cause of an effect that has several: ``thrust`` and ``mass`` of a thrust scale."""


@dataclass(frozen=True)
class HiddenDriver:
    """A common, unrecorded cause of the axes' drifts, along `direction`."""

    p: float
    direction: tuple[float, float, float]
    sensor: Sensor


@dataclass(frozen=True)
class Unknown:
    """What no effect of the catalogue explains.

    `log_odds` of bets that more than white noise is left over (:mod:`calib.gap.unknown.discrepancy`): where nothing is,
    it exceeds x with a chance of at most exp(-x). None: no noise was declared that could be compared with it.
    """

    flag: bool = False
    share: float = 0.0
    shape: str = ""
    hidden_driver: HiddenDriver | None = None
    log_odds: float | None = None


@dataclass(frozen=True)
class SequenceStep:
    """Part of the gap that is closed once this effect is added to the previous ones."""

    add: str
    closed: float


_WIDEST = 1.0
"""Width of the 95 % interval of a share above which it is meaningless. Chosen, not measured: the whole gap."""


@dataclass(frozen=True)
class Shrink:
    """How far the gap shrinks on data that were held out, in nats a sample.

    `rms` holds, by sensor, the root mean square of the residual before and after, and the unit.
    """

    before: float
    after: float
    floor: float
    floor_source: str
    closed: float | None
    ci95: tuple[float, float] | None
    nested: bool
    sequence: tuple[SequenceStep, ...] = ()
    rms: Mapping[str, tuple[float, float, str]] = field(default_factory=dict)
    metric: str = "heldout_nlpd"

    @property
    def known(self) -> float | None:
        """`closed` where the held-out blocks agree on it; None where its 95 % interval is wider than the whole gap."""
        if self.ci95 is not None and self.ci95[1] - self.ci95[0] > _WIDEST:
            return None
        return self.closed


@dataclass(frozen=True)
class NotTestable:
    """An effect that these recordings cannot show, the reason, and what is needed."""

    id: str
    reason: str
    need: str


@dataclass(frozen=True)
class Power:
    """The smallest value of a parameter that these recordings would show with a probability of one half."""

    id: str
    name: str
    smallest: float
    unit: str


@dataclass(frozen=True)
class MultipleTesting:
    """Number of tests, and the chance that any of them fires without a gap."""

    m: int
    alpha_family: float
    grid_corrected: bool = True


@dataclass(frozen=True)
class Inputs:
    """Recordings, reference and version of the diagnoser."""

    real_sha256: str | None
    sim_sha256: str | None
    fs_hz: float
    duration_s: float
    reference_kind: str
    att_sigma_deg: float
    reference_text: str
    declared_noise: Mapping[str, tuple[float, ...]]
    diagnoser_sha256: str

    @property
    def useless(self) -> bool:
        """Whether the reference's attitude is too inaccurate to judge any sensor by it."""
        return is_useless(self.reference_kind, self.att_sigma_deg)


def is_useless(kind: str, att_sigma_deg: float) -> bool:
    """Whether a reference of `kind` with that error of attitude can judge no sensor."""
    return kind == RE_ESTIMATED and not att_sigma_deg < USELESS_DEG


@dataclass(frozen=True, eq=False)
class SeriesFit:
    """One sensor's residual before and after the effects, for plots; not part of the JSON.

    `residual`, `modelled` (N, 3); `sigma` (3,) of one sample; `parts` by effect id (N, 3). `ideal` (N, 3) is what an
    ideal sensor read, None where the series is a combination of instances; `covariates` (N,) by name, those that were
    recorded: temperature (degC), current (A), throttle. `power` (K, 3) is the final noise of the model, in variance
    of one sample. Its frequencies are those of a cosine transform, from 0 to half the sampling rate; None: not known.
    """

    sensor: Sensor
    instances: tuple[int, ...]
    t: Array
    residual: Array
    modelled: Array
    sigma: Array
    unit: str
    parts: Mapping[str, Array]
    ideal: Array | None = None
    covariates: Mapping[str, Array] = field(default_factory=dict)
    power: Array | None = None


@dataclass(frozen=True, eq=False)
class GapReport:
    """Where a sensor differs from the simulated one, which effects cause it, and how far they close the gap."""

    inputs: Inputs
    verdict: GapVerdict
    where: tuple[LocatedGap, ...] = ()
    effects: tuple[EffectEstimate, ...] = ()
    unknown: Unknown = Unknown()
    shrink: Shrink | None = None
    not_testable: tuple[NotTestable, ...] = ()
    power: tuple[Power, ...] = ()
    multiple_testing: MultipleTesting = MultipleTesting(0, 0.005)
    warnings: tuple[str, ...] = ()
    series: tuple[SeriesFit, ...] = ()
    airframe: AirframePart | None = None
    """None: the recordings do not say what the motors were told."""
    left_out: tuple[str, ...] = ()
    """Stages that were not finished, so that the diagnosis ended in time (:class:`calib.gap.progress.GapStage`)."""

    @property
    def tested(self) -> bool:
        """Whether anything could be tested; otherwise the verdict applies to no sensor."""
        return self.multiple_testing.m > 0 or bool(self.effects)

    def plot(self) -> Drawing:
        """Residuals and spectra before and with the effects, as a picture (SVG).

        Raises
        ------
        InvalidInputError
            If the report carries no residuals: none was testable, or it was read from JSON.
        """
        from mavcal.calib.plots.gap import plotted

        return plotted(self.series, f"Gap: {self.verdict.replace('_', ' ')}")

    def __repr__(self) -> str:
        return self._summary().text()

    def _repr_html_(self) -> str:
        return self._summary().html()

    def _summary(self) -> Summary:
        closed = None if self.shrink is None else self.shrink.known
        shrunk = "" if closed is None else f"; the effects close {100.0 * closed:.0f} % of the gap on held-out data"
        found = "1 effect" if len(self.effects) == 1 else f"{len(self.effects)} effects"
        title = f"Gap: {self.verdict.replace('_', ' ')}, {found}{shrunk}"
        rows = tuple(row for effect in self.effects for row in _rows(effect))
        unknown = ("something has no name in the catalogue",) if self.unknown.flag else ()
        missing = ", ".join(one.id for one in self.not_testable)
        count = len(self.not_testable)
        untested = (f"{count} effects cannot be tested with these recordings: {missing}",) if missing else ()
        columns = ("effect", "sensor", "probability", "parameter", "value", "95 % interval", "unit")
        return Summary(title, columns, rows, (*unknown, *untested, *self.warnings))


def _rows(effect: EffectEstimate) -> Iterator[tuple[str, ...]]:
    """One row for each parameter; the first one names the effect."""
    sensor = f"{effect.sensor or effect.domain} {'+'.join(map(str, effect.instances))}".strip()
    first = (effect.id, sensor, f"{effect.evidence.probability:.3f}")
    for one in effect.params or (None,):
        if one is None:
            yield (*first, "", "", "", "")
        else:
            yield (*first, one.name, f"{one.value:.4g}", f"{one.ci95[0]:.4g} to {one.ci95[1]:.4g}", one.unit)
        first = ("", "", "")


def as_json(report: GapReport) -> Json:
    """The JSON of GAP 8, plus ``power`` and ``tested``."""
    return {"schema": SCHEMA, **CONVERTER.unstructure(report), "tested": report.tested}


def _made() -> Converter:
    made = make_converter()
    written = make_dict_unstructure_fn(Inputs, made)

    def write_inputs(inputs: Inputs) -> Json:
        data = written(inputs)
        reference = {"kind": "reference_kind", "att_sigma_deg": "att_sigma_deg", "text": "reference_text"}
        moved = {name: data.pop(field) for name, field in reference.items()}
        return {**data, "reference": {**moved, "useless": inputs.useless}}

    made.register_unstructure_hook(Inputs, write_inputs)
    made.register_unstructure_hook(
        AirframePart, make_dict_unstructure_fn(AirframePart, made, traces=override(omit=True))
    )
    made.register_unstructure_hook(GapReport, make_dict_unstructure_fn(GapReport, made, series=override(omit=True)))
    return made


CONVERTER = _made()
"""Converter of a report and its parts to JSON."""
