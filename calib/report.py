"""The one serialiser of fits, write plans, verifications and the steps of a procedure.

Everything that leaves ``calib`` as JSON passes here: the command line, the REST API, the store and the exports. What
is stored comes back exactly (``fit_from_json(fit_to_json(fit))`` has the same bits), so a restarted job works on the
same digits. Numbers that are not finite do not exist in JSON: they become null.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import Enum
from types import MappingProxyType
from typing import Any

import numpy as np

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.plan import (
    AfterWrite,
    Agreement,
    Change,
    Fingerprint,
    Loss,
    Movement,
    ParameterKind,
    ParameterVerdict,
    SensorCheck,
    SensorVerdict,
    Verdict,
    Verification,
    WritePlan,
)
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Done, GaveUp, Number, Pose, Progress, Prompt, Step
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel

Json = dict[str, Any]


def plain(value: Any) -> Any:
    """`value` in the types of JSON: arrays become lists, enums their values, numbers that are not finite null.

    Raises
    ------
    InvalidInputError
        If `value` is of a type that JSON cannot carry.
    """
    if isinstance(value, Enum):
        return value.value
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    raise InvalidInputError(f"{type(value).__name__} has no form in JSON")


def fit_to_json(fit: FitResult) -> Json:
    """The JSON of a fit: the keys of DESIGN 4, and ``sensor instance temperature covariance`` beside them.

    ``sd`` has the shape of ``model``; it is 0 where the method holds a value fixed and null where the data do not
    determine it.
    """
    model, sd = fit.model, fit.sd
    return {
        "method": fit.method,
        "sensor": fit.sensor.value,
        "instance": fit.instance,
        "status": fit.status.value,
        "message": fit.message,
        "n_samples": fit.n_samples,
        "n_used": fit.n_used,
        "relative": fit.relative,
        "model": _model(model.offset, model.matrix, model.polynomial),
        "sd": _model(sd[:3], sd[3:12].reshape(3, 3), _polynomial_sd(fit)),
        "native": plain(fit.native),
        "residual_rms": plain(float(fit.residual_rms)),
        "unit": fit.unit,
        "condition_number": plain(float(fit.condition_number)),
        "undetermined": list(fit.undetermined),
        "movements": dict(fit.movements),
        "warnings": list(fit.warnings),
        "quality": plain(fit.quality),
        "temperature": plain(fit.temperature),
        "covariance": plain(fit.covariance),
    }


def fit_from_json(data: Mapping[str, Any]) -> FitResult:
    """The fit that :func:`fit_to_json` described, with the same bits.

    Raises
    ------
    InvalidInputError
        If `data` is not the JSON of a fit.
    """
    with _reading("a fit"):
        model = data["model"]
        return FitResult(
            method=data["method"],
            sensor=Sensor(data["sensor"]),
            instance=data["instance"],
            status=FitStatus(data["status"]),
            message=data["message"],
            model=TriadModel(model["offset"], model["matrix"], _polynomial_from(model["polynomial"])),
            covariance=np.array(data["covariance"], dtype=np.float64),
            unit=data["unit"],
            n_samples=data["n_samples"],
            n_used=data["n_used"],
            residual_rms=_number(data["residual_rms"]),
            condition_number=_number(data["condition_number"]),
            relative=data["relative"],
            undetermined=tuple(data["undetermined"]),
            movements=data.get("movements", {}),
            warnings=tuple(data["warnings"]),
            temperature=data["temperature"],
            quality=MappingProxyType(dict(data["quality"])),
            native=MappingProxyType(dict(data["native"])),
        )


def plan_to_json(plan: WritePlan) -> Json:
    """The JSON of a write plan, with its digest and whether it needs a restart."""
    return {**plain(plan), "needs_reboot": plan.needs_reboot, "sha256": plan.sha256}


def plan_from_json(data: Mapping[str, Any]) -> WritePlan:
    """The plan that :func:`plan_to_json` described; integers stay integers.

    Raises
    ------
    InvalidInputError
        If `data` is not the JSON of a plan, or its digest is not that of its content.
    """
    with _reading("a write plan"):
        fingerprint = data["fingerprint"]
        plan = WritePlan(
            fingerprint=Fingerprint(
                **{**fingerprint, "device_ids": tuple((name, value) for name, value in fingerprint["device_ids"])}
            ),
            snapshot_sha256=data["snapshot_sha256"],
            changes=tuple(_change_from(change) for change in data["changes"]),
            losses=tuple(Loss(**{**loss, "sensor": Sensor(loss["sensor"])}) for loss in data["losses"]),
            after=tuple(_after_from(after) for after in data["after"]),
            warnings=tuple(data["warnings"]),
            blockers=tuple(data["blockers"]),
            agreements=tuple(Agreement(**{**a, "sensor": Sensor(a["sensor"])}) for a in data.get("agreements", ())),
        )
        digest = data.get("sha256", plan.sha256)
    if digest != plan.sha256:
        raise InvalidInputError("the write plan was altered: its digest is not that of its content; plan again")
    return plan


def verification_to_json(verification: Verification) -> Json:
    """The JSON of a physical check, with its summary."""
    return {
        **plain(verification),
        "proved": verification.proved,
        "contradicted": list(verification.contradicted),
        "refuted": [f"{check.id} of {check.sensor} {check.instance + 1}" for check in verification.refuted],
    }


def verification_from_json(data: Mapping[str, Any]) -> Verification:
    """The check that :func:`verification_to_json` described.

    Raises
    ------
    InvalidInputError
        If `data` is not the JSON of a check.
    """
    with _reading("a verification"):
        return Verification(
            parameters=tuple(
                ParameterVerdict(**{**item, "verdict": Verdict(item["verdict"])}) for item in data["parameters"]
            ),
            movement=_movement_from(data["movement"]),
            sensors=tuple(_sensor_check_from(item) for item in data.get("sensors", ())),
            unseen=tuple(data.get("unseen", ())),
        )


def step_to_json(step: Step) -> Json:
    """The JSON of what a procedure said; ``type`` is prompt, progress, done or gave_up."""
    if isinstance(step, Done):
        return {"type": "done", "results": [fit_to_json(fit) for fit in step.results], "because": step.because}
    kinds: dict[type, str] = {Prompt: "prompt", Progress: "progress", GaveUp: "gave_up"}
    return {"type": kinds[type(step)], **plain(step)}


def step_from_json(data: Mapping[str, Any]) -> Step:
    """The step that :func:`step_to_json` described.

    Raises
    ------
    InvalidInputError
        If `data` is not the JSON of a step.
    """
    with _reading("a step of a procedure"):
        fields = {key: value for key, value in data.items() if key != "type"}
        match data["type"]:
            case "prompt":
                return _prompt_from(fields)
            case "progress":
                return Progress(**fields)
            case "done":
                return Done(tuple(fit_from_json(fit) for fit in fields["results"]), fields["because"])
            case "gave_up":
                return GaveUp(**fields)
            case other:
                raise InvalidInputError(f"a procedure says no step of type {other!r}")


@contextmanager
def _reading(what: str) -> Iterator[None]:
    """Turns what goes wrong while stored JSON is read into one typed error."""
    try:
        yield
    except InvalidInputError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidInputError(f"this is not the JSON of {what}: {type(error).__name__} {error}") from error


def _model(offset: Any, matrix: Any, polynomial: ThermalPolynomial | Json | None) -> Json:
    return {"offset": plain(offset), "matrix": plain(matrix), "polynomial": plain(polynomial)}


def _polynomial_sd(fit: FitResult) -> Json | None:
    if fit.model.polynomial is None:
        return None
    return {"t_ref": 0.0, "t_min": 0.0, "t_max": 0.0, "coefficients": fit.sd[12:].reshape(3, fit.degree)}


def _polynomial_from(data: Mapping[str, Any] | None) -> ThermalPolynomial | None:
    if data is None:
        return None
    t_min = -math.inf if data["t_min"] is None else data["t_min"]
    t_max = math.inf if data["t_max"] is None else data["t_max"]
    return ThermalPolynomial(data["t_ref"], t_min, t_max, np.array(data["coefficients"], dtype=np.float64))


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _movement_from(data: Mapping[str, Any] | None) -> Movement | None:
    return None if data is None else Movement(**{**data, "faces": tuple(data["faces"])})


def _sensor_check_from(data: Mapping[str, Any]) -> SensorCheck:
    return SensorCheck(**{**data, "sensor": Sensor(data["sensor"]), "verdict": SensorVerdict(data["verdict"])})


def _change_from(data: Mapping[str, Any]) -> Change:
    sensor = None if data["sensor"] is None else Sensor(data["sensor"])
    return Change(**{**data, "kind": ParameterKind(data["kind"]), "sensor": sensor})


def _after_from(data: Mapping[str, Any]) -> AfterWrite:
    a, b, c, d, e, f, g = data["params"]
    return AfterWrite(data["command"], (a, b, c, d, e, f, g), data["why"])


def _prompt_from(fields: Mapping[str, Any]) -> Prompt:
    number = fields.get("number")
    return Prompt(
        **{
            **fields,
            "pose": None if fields["pose"] is None else Pose(fields["pose"]),
            "detected": None if fields["detected"] is None else Pose(fields["detected"]),
            "remaining": tuple(Pose(pose) for pose in fields["remaining"]),
            "direction": _three(fields["direction"]),
            "answers": tuple(fields["answers"]),
            "axis": _three(fields.get("axis")),
            "number": None if number is None else Number(**number),
        }
    )


def _three(values: Any) -> tuple[float, float, float] | None:
    if values is None:
        return None
    x, y, z = values
    return (x, y, z)
