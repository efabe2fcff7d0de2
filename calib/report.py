"""The one serialiser of fits, write plans, verifications and the steps of a procedure.

Everything that leaves ``calib`` as JSON passes here: the command line, the REST API, the store and the exports. What
is stored comes back exactly (``from_json(to_json(fit), FitResult)`` has the same bits), so a restarted job works on the
same digits. Numbers that are not finite do not exist in JSON: they become null.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from cattrs import Converter
from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn

from mavcal.calib.converter import lenient, make_converter, read
from mavcal.calib.errors import InvalidInputError
from mavcal.calib.firmware.plan import Verification, WritePlan
from mavcal.calib.fit import FitResult
from mavcal.calib.procedures.protocol import Done, GaveUp, Progress, Prompt
from mavcal.calib.triad import ThermalPolynomial

Json = dict[str, Any]
T = TypeVar("T")

FIT_KEYS = (
    *("method", "sensor", "instance", "status", "message", "n_samples", "n_used", "relative", "model", "sd", "native"),
    *("residual_rms", "unit", "condition_number", "undetermined", "movements", "warnings", "quality", "temperature"),
    "covariance",
)
"""The keys of DESIGN 4, and ``sensor instance temperature covariance`` beside them, in their order."""
_STEPS: Mapping[type, str] = {Prompt: "prompt", Progress: "progress", Done: "done", GaveUp: "gave_up"}


def to_json(value: Any) -> Any:
    """`value` in the types of JSON: arrays become lists, enums their values, numbers that are not finite null.

    A fit has the standard deviations in the shape of its model, a plan its digest, a check its summary. A step of a
    procedure has its ``type``: prompt, progress, done or gave_up.

    Raises
    ------
    InvalidInputError
        If `value` is of a type that JSON cannot carry.
    """
    return CONVERTER.unstructure(value)


def from_json(data: Any, kind: type[T]) -> T:
    """The `kind` that :func:`to_json` described, with the same bits; integers stay integers.

    Raises
    ------
    InvalidInputError
        If `data` is not the JSON of a `kind`, or that of a plan whose digest is not that of its content.
    """
    return read(CONVERTER, data, kind)


def _made() -> Converter:
    made = make_converter()
    _register_fit(made)  # before what holds fits: a reader is made of the readers that there are
    _register_plan(made)
    _register_verification(made)
    for kind, name in _STEPS.items():
        _register_step(made, kind, name)
    return made


def _register_fit(made: Converter) -> None:
    polynomial = make_dict_structure_fn(ThermalPolynomial, made)

    def read_polynomial(data: Json, kind: type[ThermalPolynomial]) -> ThermalPolynomial:
        endless = {"t_min": -math.inf, "t_max": math.inf}
        return polynomial({**data, **{key: most for key, most in endless.items() if data[key] is None}}, kind)

    made.register_structure_hook(ThermalPolynomial, read_polynomial)
    written = make_dict_unstructure_fn(FitResult, made)

    def write(fit: FitResult) -> Json:
        data = {**written(fit), "sd": made.unstructure(_sd(fit))}
        return {key: data[key] for key in FIT_KEYS}

    made.register_unstructure_hook(FitResult, write)
    made.register_structure_hook(FitResult, lenient(made, FitResult))


def _sd(fit: FitResult) -> Json:
    """Standard deviations in the shape of the model: 0 where the method holds a value fixed, nan where undetermined."""
    sd, polynomial = fit.sd, None
    if fit.model.polynomial is not None:
        coefficients = sd[12:].reshape(3, fit.degree)
        polynomial = {"t_ref": 0.0, "t_min": 0.0, "t_max": 0.0, "coefficients": coefficients}
    return {"offset": sd[:3], "matrix": sd[3:12].reshape(3, 3), "polynomial": polynomial}


def _register_plan(made: Converter) -> None:
    written, known = make_dict_unstructure_fn(WritePlan, made), lenient(made, WritePlan)

    def read_plan(data: Json, kind: type[WritePlan]) -> WritePlan:
        plan = known(data, kind)
        if data.get("sha256", plan.sha256) != plan.sha256:
            raise InvalidInputError("the write plan was altered: its digest is not that of its content; plan again")
        return plan

    def write_plan(plan: WritePlan) -> Json:
        data = {**written(plan), "needs_reboot": plan.needs_reboot, "sha256": plan.sha256}
        if not plan.left_out:
            del data["left_out"]  # as plans of before there were any
        return data

    made.register_unstructure_hook(WritePlan, write_plan)
    made.register_structure_hook(WritePlan, read_plan)


def _register_verification(made: Converter) -> None:
    written = make_dict_unstructure_fn(Verification, made)

    def write(check: Verification) -> Json:
        refuted = [f"{c.id} of {c.sensor} {c.instance + 1}" for c in check.refuted]
        summary = {"proved": check.proved, "contradicted": list(check.contradicted), "refuted": refuted}
        return {**written(check), **summary}

    made.register_unstructure_hook(Verification, write)
    made.register_structure_hook(Verification, lenient(made, Verification))


def _register_step(made: Converter, kind: type, name: str) -> None:
    written: Callable[[Any], Json] = make_dict_unstructure_fn(kind, made)
    known: Callable[[Any, Any], Any] = make_dict_structure_fn(kind, made)

    def read_step(data: Json, kind: type) -> Any:
        rest = dict(data)
        if (stated := rest.pop("type")) != name:
            raise InvalidInputError(f"this is no {name} of a procedure but a step of type {stated!r}")
        return known(rest, kind)

    made.register_unstructure_hook(kind, lambda step: {"type": name, **written(step)})
    made.register_structure_hook(kind, read_step)


CONVERTER = _made()
"""Other modules copy it to register more types with a JSON form of their own."""
