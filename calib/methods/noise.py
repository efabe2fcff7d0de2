"""Methods for the noise of a sensor."""

from __future__ import annotations

from mavcal.calib.errors import InvalidInputError
from mavcal.calib.fit import FitResult
from mavcal.calib.methods import worthwhile
from mavcal.calib.methods.method import INSTANCE, FindingKind, Method, Options, Suggestion
from mavcal.calib.methods.source import Source
from mavcal.calib.noise.allan_fit import fit_allan
from mavcal.calib.option import Option
from mavcal.calib.recording import Sensor

_SENSORS = (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG)


def allan(source: Source, options: Options) -> list[FitResult]:
    """The longest rest of a vehicle's log; a table is taken whole."""
    if not source.timed:
        raise InvalidInputError("noise over time needs times: the table has none; give --rate, or a column t")
    wanted = [Sensor(s) for s in (options["sensor"],) if s != "all"] or [
        s for s in _SENSORS if source.recording.instances(s)
    ]
    fits = []
    for sensor in wanted or _SENSORS[:1]:
        for channel in source.channels(sensor):
            part = source.longest_rest(channel) if source.of_vehicle else channel
            fits.append(fit_allan(part, relative=source.relative(channel)))
    return fits


METHODS = (
    Method(
        "allan",
        "hours at rest at an even rate; minutes tell the white noise only",
        (INSTANCE, Option("sensor", ("all", *(s.value for s in _SENSORS)), "all", "only this sensor")),
        allan,
        finds=FindingKind.FIGURES,
        suggestion=Suggestion(8, worthwhile.allan),
    ),
)
"""In the order of the command line."""
