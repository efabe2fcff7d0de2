"""Garbage is not looked for while modules are loaded."""

from __future__ import annotations

import gc

import pytest

from mavcal.service.loading import loading


@pytest.mark.long
def test_garbage_is_looked_for_again_after_loading_however_that_ends() -> None:
    with loading():
        assert not gc.isenabled()
        with loading():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ImportError), loading():
        raise ImportError
    assert gc.isenabled()


def test_whoever_looks_for_none_is_left_alone() -> None:
    gc.disable()
    try:
        with loading():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
