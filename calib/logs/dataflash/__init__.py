"""DataFlash logs of ArduPilot: as tables of their messages (:class:`DataFlash`), and as a recording."""

from mavcal.calib.logs.dataflash.log import DataFlash
from mavcal.calib.logs.dataflash.reader import read_dataflash, read_dataflash_text
from mavcal.calib.logs.dataflash.tables import Log, Table
from mavcal.calib.logs.dataflash.text import TextLog

__all__ = ["DataFlash", "Log", "Table", "TextLog", "read_dataflash", "read_dataflash_text"]
