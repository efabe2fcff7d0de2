"""Tasks that misbehave, run in children of the tests."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mavcal.calib.errors import FirmwareError

Order = Mapping[str, Any]
Tell = Callable[[str], None]


def echo(order: Order, tell: Tell) -> Any:
    tell("first")
    tell("second")
    return {"order": dict(order), "pid": os.getpid(), "open": sorted(os.listdir("/proc/self/fd"))}


def hang(order: Order, tell: Tell) -> Any:
    Path(order["pid"]).write_text(str(os.getpid()))
    tell("hanging")
    time.sleep(1000)


def spin_in_c(order: Order, tell: Tell) -> Any:
    """Holds the interpreter's lock for ever, as a native parser might."""
    Path(order["pid"]).write_text(str(os.getpid()))
    tell("spinning")
    sum(iter(int, 1))


def crash(_order: Order, _tell: Tell) -> Any:
    ctypes.string_at(0)


def swallow(order: Order, _tell: Tell) -> Any:
    held = [bytearray(order["piece"]) for _ in range(order["pieces"])]
    return {"held": len(held)}


def refuse(_order: Order, _tell: Tell) -> Any:
    raise FirmwareError("this cannot be")


def break_down(_order: Order, _tell: Tell) -> Any:
    raise ZeroDivisionError


def not_json(_order: Order, _tell: Tell) -> Any:
    return {"value": float("nan")}


def overwrite(order: Order, _tell: Tell) -> Any:
    """A child that has been taken over writes what it likes as its result."""
    for _ in range(2000):
        os.write(3, b"x" * 4000 + b"\n")
    (Path(order["folder"]) / os.listdir(order["folder"])[0] / "result.json").write_text(order["text"])
    os._exit(0)


def hang_on_path(order: Order, tell: Tell) -> Any:
    """Stands in for reading a file, and never ends."""
    return hang({"pid": order["path"] + ".pid"}, tell)


def spin(_order: Order, _tell: Tell) -> Any:
    sum(iter(int, 1))


def swallow_all(_order: Order, _tell: Tell) -> Any:
    held = []
    while True:
        held.append(bytearray(2**24))
