"""``python -m bench.gap_recordings DATA``: the withheld-effect check on recordings that others made.

Nominal recordings as they are and with effects put in, labelled ones, and simulators' flights. Exit code 1: one with a
known list of effects is not named exactly.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavcal.calib import logs
from mavcal.calib.logs.tables import write_table
from mavcal.calib.recording import Recording
from mavcal.service.commands.gap_campaign import diagnoser

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
    from mavcal.calib.withheld_check import KINDS, halves, injected

    def table(recording: Recording, name: str) -> Path:
        path = folder / f"{name}.npz"
        write_table(recording, path)
        return path

    clean = dict(nominal(data))
    half = {}
    for name, recording in clean.items():
        first, second = halves(recording)
        known, half[name] = f"nothing: the second half of {name}", table(first, f"{name}_1")
        yield RealCase(f"null {name}", table(second, f"{name}_2"), None, (half[name],), known, {})
    if "broad_01" in clean:
        whole = table(clean["broad_01"], "broad_01")
        for file, known in LABELLED.items():
            recording = broad_recording(data / "broad" / file)
            yield RealCase(file.removesuffix(".mat"), table(recording, file[:2]), None, (whole,), known)
    for file, effects in SITL.items():
        path, null = data / "sitl_flights" / file, data / "sitl_flights" / "null.bin"
        if path.is_file():
            yield RealCase(f"sitl {file}", path, null, (), "injected by SIM_* parameters", effects)
    for name, recording in clean.items():
        for k, kind in enumerate(KINDS):
            changed, label = injected(halves(recording)[1], kind, 100 + k)
            known = f"{kind}, lambda {label['lambda_of_fast_noise']:.0f} of the fast noise"
            real = table(changed, f"{name}_{kind}")
            yield RealCase(f"{kind} into {name}", real, None, (half[name],), known, {kind: [1]})


def broad_recording(path: Path) -> Recording:
    """A trial of the BROAD data set: inertial unit, compass and the motion capture's pose, in ENU."""
    return logs.read(path, mapping=BROAD, world="enu", rate=2000.0 / 7.0)


def nominal(data: Path) -> Iterator[tuple[str, Recording]]:
    """Recordings of hand-held units without an effect."""
    if (path := data / "broad" / "01_undisturbed_slow_rotation_A.mat").is_file():
        yield "broad_01", broad_recording(path)
    if (path := data / "vqf_test_data" / "imu_data.npz").is_file():
        yield "vqf", logs.read(path, mapping=VQF, rate=_vqf_rate(path))
    if (path := data / "xio_fusion" / "sensor_data.csv").is_file():
        yield "xio", logs.read(path, mapping=XIO, unit_gyro="deg/s", unit_accel="g")


def _vqf_rate(path: Path) -> float:
    with np.load(path) as arrays:
        return float(arrays["sampling_rate"])


async def run(data: Path, *, nested: bool) -> AsyncIterator[dict[str, Any]]:
    """One row a case: what is known, what was said."""
    with tempfile.TemporaryDirectory(prefix="mavcal-gap-") as made:
        async with diagnoser(Path(made) / "children", timeout_s=TIMEOUT_S) as diagnosing:
            for case in cases(data, Path(made)):
                order = {
                    "real": {"path": str(case.real)},
                    "sim": None if case.sim is None else {"path": str(case.sim)},
                    "nominal": [{"path": str(p)} for p in case.nominal],
                    "nested": nested,
                }
                yield _row(case, await diagnosing.ask(order))


def _row(case: RealCase, answer: Mapping[str, Any]) -> dict[str, Any]:
    report = answer.get("report") or {}
    said = {str(e["id"]): e.get("instances") for e in report.get("effects") or []}
    return {
        "case": case.name,
        "known": case.known,
        "verdict": report.get("verdict"),
        "error": answer.get("error"),
        "effects": said,
        "unknown": bool((report.get("unknown") or {}).get("flag")),
        "exact": None if case.effects is None else bool(report) and set(said) == set(case.effects),
        "seconds": answer["seconds"],
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Every recording once, each told as soon as it is diagnosed."""
    parser = argparse.ArgumentParser(prog="python -m bench.gap_recordings", description=__doc__)
    parser.add_argument("data", type=Path, help="folder of the recordings")
    parser.add_argument("--answers", type=Path, help="keep every answer, a JSON line each, for bench.same")
    parser.add_argument("--nested", action=argparse.BooleanOptionalAction, default=True)
    return asyncio.run(_print_rows(parser.parse_args(argv)))


async def _print_rows(given: argparse.Namespace) -> int:
    wrong = False
    async for row in run(given.data, nested=given.nested):
        wrong = wrong or row["exact"] is False
        print(_row_text(row), flush=True)
        if given.answers is not None:
            with given.answers.open("a", encoding="utf-8") as kept:
                kept.write(json.dumps(row) + "\n")
    return int(wrong)


def _row_text(row: Mapping[str, Any]) -> str:
    said = ", ".join(f"{name}{instances}" for name, instances in row["effects"].items()) or "nothing"
    more = " + unknown" if row["unknown"] else ""
    return f"{row['case']}: {row['known']}\n    {row['error'] or row['verdict']}: {said}{more}"


if __name__ == "__main__":
    sys.exit(main())
