from __future__ import annotations

import numpy as np
import pytest

from mavcal.calib.blind.airframe.cases import AirTier, drafted, log_of
from mavcal.calib.blind.airframe.draw import draw_vehicle
from mavcal.calib.blind.airframe.flight import Flown
from mavcal.calib.blind.airframe.logs import Columns
from mavcal.calib.blind.airframe.vehicle import Vehicle
from tests.unit.blind.airframe.flights import flown_in_calm


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    return draw_vehicle(np.random.default_rng(8))


@pytest.fixture(scope="session")
def flown(vehicle) -> Flown:
    return flown_in_calm(vehicle)


@pytest.fixture(scope="session")
def log() -> Columns:
    """Of a seeded flight of full length."""
    rng, draft, _ = drafted(AirTier.NULL, 11)
    return log_of(draft.pair.real, draft, rng)[0]
