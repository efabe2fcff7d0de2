"""What a diagnosis was made of, for its report: recordings, reference, declared noise, and the diagnoser itself."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from mavcal.calib.gap.problem import GapProblem
from mavcal.calib.gap.schema import FIRST, Inputs


def inputs_of(problem: GapProblem) -> Inputs:
    """The inputs of a problem."""
    reference = problem.reference
    noise = {
        f"{t.sensor.value}{t.instances[0] + FIRST}": tuple(map(float, t.sigma))
        for t in problem.traces
        if t.sigma is not None and t.against is None
    }
    return Inputs(
        problem.inputs.get("real"),
        problem.inputs.get("sim"),
        max((t.fs for t in problem.traces), default=0.0),
        problem.duration_s,
        reference.kind.value,
        reference.att_sigma_deg,
        reference.text,
        noise,
        diagnoser_sha256(),
    )


@cache
def diagnoser_sha256() -> str:
    """Over the sources of ``calib.gap``: which diagnoser spoke."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
