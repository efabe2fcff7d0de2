"""Ends this process when another one ends, even if that one is killed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Mapping

ENDS_WITH = "_MAVCAL_ENDS_WITH"
"""Environment variable: id of the process with which ours, and all that it starts, are to end."""
_LOOK_S = 1.0
_GRACE_S = 15.0
"""From SIGTERM to SIGKILL."""


def ending_with_us(environment: Mapping[str, str] | None = None) -> dict[str, str]:
    """An environment for a child that ends when this process does, in whatever way that ends."""
    return {**(os.environ if environment is None else environment), ENDS_WITH: str(os.getpid())}


def follow(environment: Mapping[str, str] = os.environ, *, end: Callable[[], None] | None = None) -> bool:
    """End as soon as the process that the environment names is gone; False if it names none."""
    named = environment.get(ENDS_WITH, "")
    if not named.isdigit() or int(named) == os.getpid():
        return False
    threading.Thread(target=_watch, args=(int(named), end or _end), name="ends-with", daemon=True).start()
    return True


def alive(pid: int) -> bool:
    """Whether there is such a process, whosever it is."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _watch(pid: int, end: Callable[[], None]) -> None:
    while alive(pid):
        time.sleep(_LOOK_S)
    end()


def _end() -> None:
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_GRACE_S)
    os.kill(os.getpid(), signal.SIGKILL)
