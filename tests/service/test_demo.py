"""The demonstration end to end, one seed an autopilot; `python -m bench.seeds` runs twenty in a row."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from tests.patience import scaled


@pytest.mark.campaign
@pytest.mark.timeout(400)
@pytest.mark.parametrize(("autopilot", "seed"), [("ardupilot", 11), ("px4", 12)])
def test_every_parameter_is_proved_and_every_uncertainty_is_true(autopilot, seed):
    command = [sys.executable, "-m", "service", "demo", "--autopilot", autopilot, "--seed", str(seed), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=scaled(380), check=False)
    found = json.loads(done.stdout)
    assert found["ok"], (found["reasons"], done.stderr[-500:])
    assert done.returncode == 0
    assert found["largest_z"] <= 4.5
    assert found["p_value"] >= 1e-4
    assert found["chi2"] >= found["dof"] / 4  # nor is the stated sd more than twice the errors
    assert {job["kind"] for job in found["jobs"]} == {"gyro", "accel", "mag", "thermal"}
    costs = [
        (loss["cost"], sensor["cross"], sensor["after"])
        for job in found["jobs"]
        if job["kind"] == "accel"
        for loss, sensor in zip(
            [x for x in job["plan"]["losses"] if "cross-axis" in x["what"] or "cross" in x["text"]],
            [s for s in found["sensors"] if s["sensor"] == "accel"],
            strict=False,
        )
    ]
    assert costs
    for announced, true, left in costs:
        assert abs(announced - true) < 0.01  # the fit knows the cross terms as well as it says
        assert left < announced + 0.02
