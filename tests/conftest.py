from __future__ import annotations

from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the real recordings, which are not part of this repository."""
    if not SHARED.is_dir():
        pytest.skip("the recordings of ../shared/data are not here")
    return SHARED
