"""What the methods do not say of themselves: when to take one, its blind spots, and what it writes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

_ACCEL = "INS_ACCOFFS, INS_ACCSCAL · CAL_ACCn_OFF, _SCALE"
_GYRO = "INS_GYROFFS · CAL_GYROn_OFF"
_MAG = "COMPASS_OFS, DIA, ODI, SCALE · CAL_MAGn_OFF, SCALE, ODIAG"
_THERMAL = "INS_TCALn_ACC, _GYR · TC_An, TC_Gn"
_NOTHING = "nothing"


@dataclass(frozen=True)
class Note:
    """`when` to take it, what it cannot see (`blind`), and what it `writes`: ArduPilot · PX4."""

    when: str
    blind: str
    writes: str


NOTES: Mapping[str, Note] = {
    "accel-one-axis": Note(
        "a quick check on a level table",
        "scale and cross terms; a tilt of 1° reads as 0.17 m/s² of offset",
        _ACCEL.replace(", INS_ACCSCAL", "").replace(", _SCALE", ""),
    ),
    "accel-six-face": Note(
        "a fixture whose squareness is known", "anything below the fixture's own tilt (state `--fixture-sd`)", _ACCEL
    ),
    "accel-multi": Note(
        "no fixture: held by hand, in any direction", "the rotation of the sensor in the vehicle (see `level`)", _ACCEL
    ),
    "accel-thermal": Note(
        "faces and warm-up in one session",
        "a drift that time makes and not temperature, unless the faces are visited again in opposite order",
        f"{_ACCEL}; {_THERMAL.split(' · ')[0].split(',')[0]} · TC_An",
    ),
    "gyro-rest": Note("always, and first", "scale, axes, and the Earth's rate (0.004 °/s), which stays inside", _GYRO),
    "gyro-turntable": Note(
        "a turntable with a known rate",
        "the axes that did not turn; rates beyond those of the table",
        f"{_GYRO}; scale and cross axes: {_NOTHING}, no firmware holds them",
    ),
    "gyro-thread": Note(
        "no turntable: the vehicle hangs on a thread",
        "the other two axes; half a turn that was miscounted",
        f"{_GYRO}; scale: {_NOTHING}, no firmware holds it",
    ),
    "gyro-g-sensitivity": Note(
        "vibration or manoeuvres disturb the gyro",
        "a drift over the minutes that the rests take (`--drift yes`); the vertical Earth rate without `--latitude`",
        f"{_NOTHING}: a finding for the simulator and for the choice of a sensor",
    ),
    "mag-minmax": Note("a first look", "noise and spikes (it takes the extremes for the truth), cross terms", _MAG),
    "rest-reference": Note(
        "two reference vectors and the attitude they imply", "any error of the sensors: it trusts them", _NOTHING
    ),
    "mag-sphere": Note("soft iron is known to be negligible", "soft iron: it goes into the offset", _MAG),
    "mag-ellipsoid-axis": Note(
        "to compare with the published form", "cross terms of the soft iron: they bias it", _MAG
    ),
    "mag-ellipsoid": Note(
        "the vehicle can be turned to every side",
        "the mounting of the compass, and the field's strength unless it is stated",
        _MAG,
    ),
    "mag-rings": Note(
        "a block with square faces and no accelerometer",
        "anything below the block's squareness; useless where the dip is near zero",
        f"{_MAG}; mounting: COMPASS_ORIENT, CUST_ROT · CAL_MAGn_ROT, ROLL, PITCH, YAW",
    ),
    "mag-align": Note(
        "the mounting matters and the accelerometer is calibrated",
        "a rotation about the vertical at the magnetic poles; errors of the accelerometer go into the mounting",
        f"{_MAG}; mounting: COMPASS_ORIENT, CUST_ROT · CAL_MAGn_ROT, ROLL, PITCH, YAW",
    ),
    "mag-gyro": Note(
        "no calibrated accelerometer, or it is shaken", "the matrix's common scale; slow motion tells it little", _MAG
    ),
    "mag-flight": Note("only a flight is there", "what the flight's attitudes did not show", _MAG),
    "mag-motor": Note("the heading turns with throttle", "currents that were not drawn", "COMPASS_MOT · CAL_MAGn_COMP"),
    "thermal-linear": Note(
        "a short span, or to compare", "curvature, hysteresis; one sweep cannot show either", _THERMAL
    ),
    "thermal-poly": Note(
        "a warm-up of ten degrees or more",
        "temperatures that were not visited (clamped, never extrapolated); the offset itself",
        _THERMAL,
    ),
    "mag-thermal": Note(
        "a compass whose heading moves while it warms up",
        "a field that changes with time; in one pose, offset from sensitivity",
        f"{_NOTHING}: a finding for the choice and the place of a compass",
    ),
    "imu-multi": Note(
        "the best for both sensors without any fixture",
        "the rotation of the whole unit in the vehicle; what the movements did not turn about",
        f"{_ACCEL}; {_GYRO}; gyro scale: {_NOTHING}",
    ),
    "allan": Note(
        "noise for an estimator or a simulator",
        "anything slower than a tenth of the recording; a filter hides the fast part and is said",
        _NOTHING,
    ),
}
"""By the method's name."""
