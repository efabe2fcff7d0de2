from __future__ import annotations

import pytest

from mavcal.calib.recording import Recording
from tests.unit.airframe.flights import flight


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A flight of the default frame, for the simulator's side."""
    return flight(tmp_path_factory.mktemp("simulated") / "x.bin")


@pytest.fixture(scope="session")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """A second one in another order on another day."""
    return flight(
        tmp_path_factory.mktemp("usual") / "x.bin", other=True, SIM_WIND_SPD=2.0, SIM_WIND_DIR=200.0
    )  # fmt: skip
