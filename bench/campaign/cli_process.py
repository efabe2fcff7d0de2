"""The command line in a process that kills itself at a named instant, as if from outside.

``python -m bench.campaign.cli_process POINT OCCURRENCE calibrate gyro --apply …``: at the OCCURRENCE-th time that the
job engine reaches POINT (:class:`service.jobs.core.crashpoints.At`) the process gets SIGKILL.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Sequence
from functools import partial

import mavcal.service.core
from mavcal.service.cli import main
from mavcal.service.jobs.core.crashpoints import At, CrashPoint


def killer(point: At, occurrence: int) -> CrashPoint:
    """A crash point that is fatal."""
    count = 0

    def reach(at: At) -> None:
        nonlocal count
        count += at == point
        if at == point and count == occurrence:
            os.kill(os.getpid(), signal.SIGKILL)

    return reach


def run(arguments: Sequence[str]) -> None:
    """Run the command line under a killer."""
    point, occurrence, *rest = arguments
    running = partial(mavcal.service.core.running_service, reach=killer(At(point), int(occurrence)))
    mavcal.service.core.running_service = running  # type: ignore[assignment]
    main(rest)


if __name__ == "__main__":
    run(sys.argv[1:])
