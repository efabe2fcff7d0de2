"""Objects of the domain with every field set, as they go over HTTP."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib.firmware.plan import (
    AfterWrite,
    Agreement,
    Change,
    Fingerprint,
    Loss,
    Movement,
    ParameterKind,
    ParameterVerdict,
    ProofVerdict,
    SensorCheck,
    SensorCheckId,
    SensorVerdict,
    Verification,
    WritePlan,
)
from mavcal.calib.fit import FitResult, FitStatus
from mavcal.calib.procedures.protocol import Number, Pose, Progress, Prompt, PromptStep
from mavcal.calib.recording import Sensor
from mavcal.calib.triad import ThermalPolynomial, TriadModel
from mavcal.service.jobs.core.model import Accept, Attempt, Failure, Holds, Job, LogSpan, Result, Standing, WriteResult
from mavcal.service.jobs.core.proof import ProofLevel, Unproved
from mavcal.service.jobs.core.states import JobState

FINGERPRINT = Fingerprint("px4", "0002aa", "1.17.0", (("CAL_GYRO0_ID", 7), ("CAL_ACC0_ID", 8)))
PROMPT = Prompt(
    PromptStep.POSE, "Put it on its left side.",
    pose=Pose.LEFT, remaining=(Pose.LEFT, Pose.BACK), hold_s=2.0, rotate=True,
    direction=(0.0, 1.0, 0.0), temperature=25.0, detected=Pose.LEVEL, stable=True, answers=("finish",),
    axis=(0.0, 0.0, 1.0), turns=3.0, number=Number("rate", "deg/s", 1.0, 90.0),
)  # fmt: skip
PROGRESS = Progress(1.0, 6.0, "poses", "recording", eta=12.5, detail={"mask": 3, "rest_s": 1.0})
RESULT = Result("It is written.", ProofLevel.PARTIAL, "Not all.", (Unproved("X", "consistent", "turn it"),))
FAILURE = Failure("in-doubt", "the vehicle fell silent", "switch it on")
VERIFICATION = Verification(
    (
        ParameterVerdict("X", ProofVerdict.CONSISTENT, 0.5, 0.1, "rad/s", "says so", acts_on_stream=False),
        ParameterVerdict("Y", ProofVerdict.CONTRADICTED, float("inf"), 0.1, "m/s2", "no effect"),
    ),
    Movement("Turn it.", ("left",), turn=True, temperature=20.0),
    (
        SensorCheck(SensorCheckId.GYRO_ZERO, Sensor.GYRO, 1, 0.1, 0.2, "rad/s", 0.01, SensorVerdict.RIGHT, "at rest"),
        SensorCheck(SensorCheckId.LEVEL, Sensor.ACCEL, 0, None, None, "rad", None, SensorVerdict.WRONG, "off"),
    ),
    ("X",),
)
PLAN = WritePlan(
    FINGERPRINT,
    "0" * 64,
    (
        Change("X", 0.0, 0.5, ParameterKind.REAL32, "offset", sd=0.1, unit="rad/s", sensor=Sensor.GYRO),
        Change("Y", None, 3, ParameterKind.INT32, "a flag", needs_reboot=True, session=True),
    ),
    (Loss(Sensor.MAG, 1, "rotation", 2.5, "deg", "The compass cannot be turned by 2.5 deg."),),
    (AfterWrite(241, (0.0, 0.0, 0.0, 0.0, 76.0, 0.0, 0.0), "it marks the accelerometers"),),
    ("careful",),
    ("not now",),
    (Agreement(Sensor.ACCEL, 0, 0.75, "It agrees."),),
)


def fit() -> FitResult:
    """A thermal fit with an offset that is not determined."""
    polynomial = ThermalPolynomial(25.0, float("-inf"), 60.0, np.array([[1e-3, 2e-5], [0.0, 0.0], [-1e-3, 1e-7]]))
    model = TriadModel(np.array([0.1, 0.2, 0.3]), np.diag([1.0, 1.01, 0.99]), polynomial)
    covariance = np.diag(np.arange(18.0) * 1e-6)
    covariance[2, 2] = 0.0
    return FitResult(
        method="thermal-poly",
        sensor=Sensor.GYRO,
        instance=1,
        status=FitStatus.PARTIAL,
        message="one is open",
        model=model,
        covariance=covariance,
        unit="rad/s",
        n_samples=5,
        n_used=4,
        residual_rms=1e-3,
        condition_number=float("nan"),
        undetermined=("offset_z",),
        movements={"offset_z": "turn it"},
        warnings=("few samples",),
        temperature=30.0,
        quality={"coverage": 0.5, "poses": 3, "began": float("nan")},
        native={"slopes": [1e-3, 0.0, -1e-3], "t_ref": 25},
    )


def job(**changes: Any) -> Job:
    """A job with every field set."""
    fields: dict[str, Any] = {
        "id": "j1",
        "vehicle_id": "v1",
        "kind": "gyro",
        "options": {"uncertainty": 0.1, "extend": True},
        "state": JobState.IN_DOUBT,
        "created_at": 1.5,
        "updated_at": 2.5,
        "fingerprint": FINGERPRINT,
        "progress": PROGRESS,
        "prompt": PROMPT,
        "outcome": FAILURE,
        "results": (fit(),),
        "plan": PLAN,
        "accept": Accept("1" * 64, reboot=True, prove_s=7.0, actor="somebody"),
        "verification": VERIFICATION,
        "segments": (LogSpan(Path("/data/a.tlog"), 3, 9, "2" * 64),),
        "standing": (Standing("X", 0.0, 0.5, 0.25, certain=True, note="set by hand", holds=Holds.OTHER),),
        "last_write": Attempt(WriteResult.IN_DOUBT, 3.5, "it fell silent", "switch it on", 1),
        "warnings": ("a", "b"),
        "context": {"plan_options": {"only": ["gyro1"], "keep_gyro_at_boot": True, "device_ids": {"gyro1": 7}}},
    }
    return Job(**{**fields, **changes})


def bare() -> Job:
    """A job that has just begun."""
    return Job("j2", "v1", "accel", {}, JobState.QUEUED, 1.5, 2.5)


def done() -> Job:
    """A job that reached its goal."""
    return job(id="j3", state=JobState.SUCCEEDED, outcome=RESULT, prompt=None, progress=None)
