from __future__ import annotations

from tests.unit.firmware.conftest import *  # noqa: F403 - the parameters and fits of the firmware's tests
