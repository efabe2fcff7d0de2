"""DataFlash logs of ArduPilot: as tables of their messages (:class:`DataFlash`), and as a recording."""

from __future__ import annotations

from calib.logs.dataflash.log import DataFlash, Log, Table
from calib.logs.dataflash.reader import read_dataflash

__all__ = ["DataFlash", "Log", "Table", "read_dataflash"]
