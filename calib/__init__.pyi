from typing import Final

from mavcal.calib.errors import CalibError as CalibError
from mavcal.calib.fit import FitResult as FitResult
from mavcal.calib.fit import FitStatus as FitStatus
from mavcal.calib.gap import GapReport as GapReport
from mavcal.calib.gap import run as diagnose
from mavcal.calib.library import bare as bare
from mavcal.calib.library import fit_recording as fit_recording
from mavcal.calib.library import save_fits as save_fits
from mavcal.calib.library import save_report as save_report
from mavcal.calib.logs import read as read
from mavcal.calib.methods import METHODS as METHODS
from mavcal.calib.recording import Channel as Channel
from mavcal.calib.recording import Recording as Recording
from mavcal.calib.recording import Sensor as Sensor
from mavcal.calib.recording import Stage as Stage

STANDARD_GRAVITY: Final[float]
__version__: Final[str]

__all__ = [
    "METHODS",
    "STANDARD_GRAVITY",
    "CalibError",
    "Channel",
    "FitResult",
    "FitStatus",
    "GapReport",
    "Recording",
    "Sensor",
    "Stage",
    "__version__",
    "bare",
    "diagnose",
    "fit_recording",
    "read",
    "save_fits",
    "save_report",
]
