"""The withheld-effect check on recordings that others made: nominal ones, labelled ones, simulators' flights."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mavcal.calib.recording import Recording
from mavcal.service.commands.gap_campaign import Worker

TIMEOUT_S = 1800.0
"""Limit for a recording of minutes."""
BROAD = {
    **{f"gyro_{a}": f"imu_gyr_{k}" for k, a in enumerate("xyz")},
    **{f"accel_{a}": f"imu_acc_{k}" for k, a in enumerate("xyz")},
    **{f"mag_{a}": f"imu_mag_{k}" for k, a in enumerate("xyz")},
    **{f"ref_q_{a}": f"opt_quat_{k}" for k, a in enumerate("wxyz")},
    "ref_pos_n": "opt_pos_1",
    "ref_pos_e": "opt_pos_0",
    "ref_pos_d": "opt_pos_2*-1",
}
VQF = {
    f"{name}_{a}": f"{column}_{k}" for name, column in (("gyro", "gyr"), ("accel", "acc")) for k, a in enumerate("xyz")
}
XIO = {
    "t": "Time (s)",
    **{
        f"{name}_{a.lower()}": f"{column} {a} ({unit})"
        for name, column, unit in (
            ("gyro", "Gyroscope", "deg/s"),
            ("accel", "Accelerometer", "g"),
            ("mag", "Magnetometer", "uT"),
        )
        for a in "XYZ"
    },
}
SITL = {
    "bias.bin": {"accel_bias": [1], "gyro_bias": [1], "mag_hard_iron": [1]},
    "mix.bin": {"mag_soft_iron": [1], "gyro_bias": [1]},
    "null.bin": {},
}
LABELLED = {
    "28_disturbed_stationary_magnet_A.mat": "no effect of a sensor: the magnet stands in the room",
    "32_disturbed_attached_magnet_1cm.mat": "mag_step on at about 35 s and off at about 100 s",
    "34_disturbed_attached_magnet_3cm.mat": "mag_step on at about 35 s and off at about 100 s",
    "24_disturbed_tapping_A.mat": "tapping, where it is",
}


@dataclass(frozen=True)
class RealCase:
    """Files, and in words what is known of them; `effects` where a list of ids is."""

    name: str
    real: Path
    sim: Path | None
    nominal: tuple[Path, ...]
    known: str
    effects: Mapping[str, Sequence[int]] | None = None


def cases(data: Path, folder: Path) -> Iterator[RealCase]:
    """Every case that the data folder has; derived tables are written to `folder`."""
    from mavcal.calib.blind.real import KINDS, halves, injected
    from mavcal.calib.logs.tables import write_table

    def table(recording: Recording, name: str) -> Path:
        path = folder / f"{name}.npz"
        write_table(recording, path)
        return path

    nominal = dict(_nominal(data))
    half = {}
    for name, recording in nominal.items():
        first, second = halves(recording)
        known, half[name] = f"nothing: the second half of {name}", table(first, f"{name}_1")
        yield RealCase(f"null {name}", table(second, f"{name}_2"), None, (half[name],), known, {})
    if "broad_01" in nominal:
        whole = table(nominal["broad_01"], "broad_01")
        for file, known in LABELLED.items():
            recording = broad_recording(data / "broad" / file)
            yield RealCase(file.removesuffix(".mat"), table(recording, file[:2]), None, (whole,), known)
    for file, effects in SITL.items():
        path, null = data / "sitl_flights" / file, data / "sitl_flights" / "null.bin"
        if path.is_file():
            yield RealCase(f"sitl {file}", path, null, (), "injected by SIM_* parameters", effects)
    for name, recording in nominal.items():
        for k, kind in enumerate(KINDS):
            changed, label = injected(halves(recording)[1], kind, 100 + k)
            known = f"{kind}, lambda {label['lambda_of_fast_noise']:.0f} of the fast noise"
            real = table(changed, f"{name}_{kind}")
            yield RealCase(f"{kind} into {name}", real, None, (half[name],), known, {kind: [1]})


def broad_recording(path: Path) -> Recording:
    """A trial of the BROAD data set: inertial unit, compass and the motion capture's pose, in ENU."""
    from mavcal.calib import logs

    return logs.read(path, mapping=BROAD, world="enu", rate=2000.0 / 7.0)


def _nominal(data: Path) -> Iterator[tuple[str, Recording]]:
    from mavcal.calib import logs

    if (path := data / "broad" / "01_undisturbed_slow_rotation_A.mat").is_file():
        yield "broad_01", broad_recording(path)
    if (path := data / "vqf_test_data" / "imu_data.npz").is_file():
        yield "vqf", logs.read(path, mapping=VQF, rate=_vqf_rate(path))
    if (path := data / "xio_fusion" / "sensor_data.csv").is_file():
        yield "xio", logs.read(path, mapping=XIO, unit_gyro="deg/s", unit_accel="g")


def _vqf_rate(path: Path) -> float:
    import numpy as np

    with np.load(path) as arrays:
        return float(arrays["sampling_rate"])


def run(data: Path, *, nested: bool) -> Iterator[dict[str, Any]]:
    """One row a case: what is known, what was said."""
    worker = Worker(TIMEOUT_S)
    try:
        with tempfile.TemporaryDirectory(prefix="mavcal-gap-") as made:
            for case in cases(data, Path(made)):
                order = {
                    "real": str(case.real),
                    "sim": None if case.sim is None else str(case.sim),
                    "nominal": [str(p) for p in case.nominal],
                    "without": [],
                    "nested": nested,
                }
                yield _row(case, worker.ask(order))
    finally:
        worker.close()


def _row(case: RealCase, answer: Mapping[str, Any]) -> dict[str, Any]:
    report = answer.get("report") or {}
    said = {str(e["id"]): e.get("instances") for e in report.get("effects") or []}
    reach = set(said) | {str(r["id"]) for e in report.get("effects") or [] for r in e.get("confusable_with") or []}
    return {
        "case": case.name,
        "known": case.known,
        "verdict": report.get("verdict"),
        "error": answer.get("error"),
        "effects": said,
        "unknown": bool((report.get("unknown") or {}).get("flag")),
        "closed": (report.get("shrink") or {}).get("closed"),
        "reference": ((report.get("inputs") or {}).get("reference") or {}).get("kind"),
        "exact": None if case.effects is None else bool(report) and set(said) == set(case.effects),
        "in_set": None if not case.effects else set(case.effects) <= reach,
        "seconds": answer["seconds"],
    }
