"""A service whose rooms all have something to show: vehicles, jobs, a review, a history, a log, a diagnosis."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

import numpy as np

from mavcal.client import Client

T = TypeVar("T")

WITHIN_S = 300.0
ENDED = frozenset({"succeeded", "reverted", "failed", "cancelled", "interrupted", "review"})
BIAS = np.array([0.3, -0.2, 0.15])
KEEPS = {"parameters": {"INS_GYR_CAL": 0}, "thermal": False}
"""A vehicle that keeps what is written to its gyros."""


def endpoint(system: int, *, speed: float, hand: str = "auto", seed: int = 3) -> str:
    """A simulated ArduPilot that does what its prompts ask, or nothing (`hand` "off")."""
    given = {"seed": seed, "speed": speed, "system_id": system, "hand": hand, "config": json.dumps(KEEPS)}
    return "sim:ardupilot?" + "&".join(f"{name}={quote(str(value))}" for name, value in given.items())


def furnish(client: Client) -> Mapping[str, str]:
    """Fill the rooms; each room by its name with its place in the page's address.

    A gyro is calibrated, written and proved; a compass waits in its review, and an accelerometer of another vehicle
    for a pose; a log is uploaded, another one diagnosed.
    """
    done = connected(client, endpoint(1, speed=8))
    waits = connected(client, endpoint(2, speed=1, hand="off", seed=4))
    gap = client.diagnose_gap(real=client.upload_recording(flown(), name="flight.csv").id).id
    log = client.upload_recording(at_rest(), name="rest.csv").id
    written(client, done, "gyro")
    review = reviewed(client, done, "mag")
    capture = capturing(client, waits)
    campaign = came(client, client.start_preflight_campaign(vehicles=[done]).id, "succeeded")
    until(lambda: client.get_gap(gap).state == "succeeded", "the diagnosis")
    return {
        "home": "",
        "vehicle": f"#/vehicle/{done}",
        "preflight": f"#/vehicle/{done}/preflight",
        "about": f"#/vehicle/{done}/about",
        "live": f"#/vehicle/{waits}/live",
        "capture": f"#/job/{capture}",
        "review": f"#/job/{review}",
        "campaign": f"#/campaign/{campaign}",
        "logs": "#/logs",
        "log": f"#/log/{log}",
        "gap": "#/gap",
        "diagnosis": f"#/gap/{gap}",
        "history": f"#/history/{done}",
        "setup": "#/setup",
    }


def capturing(client: Client, vehicle: str) -> str:
    """An accelerometer that waits for a pose: the one that does, or a new one (it waits three minutes and ends)."""
    for job in client.list_jobs(vehicle_id=vehicle, kind="accel"):
        if job.state not in ENDED:
            return job.id
    begun = client.start_job(vehicle, kind="accel").id
    until(lambda: client.get_job(begun).prompt, "the accelerometer's first prompt")
    return begun


def connected(client: Client, url: str) -> str:
    """Open a link, and wait for the vehicle on it: its id."""
    link = client.open_link(url=url).id
    return until(lambda: next((v.id for v in client.list_vehicles() if v.link == link and v.uid), None), "the vehicle")


def reviewed(client: Client, vehicle: str, kind: str) -> str:
    """A calibration that waits in its review."""
    job = client.start_job(vehicle, kind=kind).id
    return came(client, job, "review")


def written(client: Client, vehicle: str, kind: str) -> str:
    """A calibration that was accepted, written and looked at."""
    job = reviewed(client, vehicle, kind)
    client.apply_plan(job, plan_sha256=client.get_plan(job).sha256)
    return came(client, job, "succeeded")


def came(client: Client, job: str, state: str) -> str:
    """The job once it is in this state.

    Raises
    ------
    RuntimeError
        If it ends in another one.
    """

    def there() -> str | None:
        now = client.get_job(job).state
        if now != state and now in ENDED:
            raise RuntimeError(f"job {job} is {now}, and should be {state}")
        return job if now == state else None

    return until(there, f"state {state}")


def until(found: Callable[[], T | None], what: str) -> T:
    """Ask until there is something.

    Raises
    ------
    RuntimeError
        If there is nothing after five minutes.
    """
    end = time.monotonic() + WITHIN_S
    while not (answer := found()):
        if time.monotonic() > end:
            raise RuntimeError(f"{what} did not come within {WITHIN_S:g} s")
        time.sleep(0.2)
    return answer


def flown(seed: int = 4, seconds: float = 20.0) -> bytes:
    """A table of a tumbling flight at 50 Hz: the ideal force beside what an accelerometer with an offset read."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.02)
    ideal = sum(
        rng.normal(0.0, 3.0, 3) * np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0.0, 6.0, 3))
        for f in (0.11, 0.23, 0.41, 0.67, 1.1)
    ) + np.array([0.0, 0.0, -9.8])
    read = ideal + BIAS + 0.05 * rng.normal(size=ideal.shape)
    return table("t,accel_x,accel_y,accel_z,ref_accel_x,ref_accel_y,ref_accel_z", t, read, ideal)


def at_rest(seed: int = 1, seconds: float = 60.0) -> bytes:
    """A table of a gyro and an accelerometer at rest at 100 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    gyro = np.array([0.012, -0.004, 0.007]) + rng.normal(0.0, 0.01, (t.size, 3))
    accel = np.array([0.05, -0.12, -9.74]) + rng.normal(0.0, 0.03, (t.size, 3))
    return table("t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z", t, gyro, accel)


def table(header: str, t: np.ndarray, *columns: np.ndarray) -> bytes:
    """A CSV of these columns."""
    rows = np.column_stack([t, *columns])
    return "\n".join([header, *(",".join(f"{value:.6g}" for value in row) for row in rows)]).encode()


def large(path: Path, megabytes: int) -> Path:
    """A table of a gyro at rest that is as large as it says."""
    line = b"%.3f,0.011,-0.004,0.007\n"
    with path.open("wb") as file:
        file.write(b"t,gyro_x,gyro_y,gyro_z\n")
        k = 0
        while file.tell() < megabytes * 1_000_000:
            file.write(b"".join(line % ((k + i) / 1000) for i in range(10_000)))
            k += 10_000
    return path
