from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

import service  # noqa: F401  before numpy is loaded: it keeps numpy to one thread

# Wall-clock deadlines judge the machine, not the code; failures print the seed that repeats them.
settings.register_profile("mavcal", deadline=None, print_blob=True)
settings.load_profile("mavcal")

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings, which are not part of this repository."""
    if not SHARED.is_dir():
        pytest.skip("the recordings of ../shared/data are not here")
    return SHARED
