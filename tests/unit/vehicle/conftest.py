from __future__ import annotations

import pytest

from tests.unit.vehicle.fake import PX4_CAPABILITIES, FakeVehicle


@pytest.fixture
async def ardupilot() -> FakeVehicle:
    return FakeVehicle()


@pytest.fixture
async def px4() -> FakeVehicle:
    return FakeVehicle(autopilot=12, capabilities=PX4_CAPABILITIES)
