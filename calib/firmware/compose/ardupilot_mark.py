"""ArduPilot's code 76, which marks sensors as calibrated, so that the vehicle arms (FLIGHT_CONTROLLERS 1.1).

The code marks every sensor of its kind. It is therefore sent only if every one in use is calibrated (DESIGN 6).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from mavcal.calib.firmware import names
from mavcal.calib.firmware.ardupilot import parameters as ardupilot
from mavcal.calib.firmware.compose.draft import Draft
from mavcal.calib.firmware.names import Role
from mavcal.calib.recording import Sensor

PREFLIGHT_CALIBRATION: Final = 241


@dataclass(frozen=True)
class _Kind:
    """One kind of sensor: its words, the command's parameters, and the switch of its use."""

    one: str
    many: str
    code: tuple[float, float, float, float, float, float, float]
    use: str


_KINDS: Final[Mapping[Sensor, _Kind]] = {
    Sensor.ACCEL: _Kind("accelerometer", "accelerometers", (0.0, 0.0, 0.0, 0.0, 76.0, 0.0, 0.0), "INS_USE"),
    Sensor.MAG: _Kind("compass", "compasses", (0.0, 76.0, 0.0, 0.0, 0.0, 0.0, 0.0), "COMPASS_USE"),
}


def mark_calibrated(draft: Draft, sensor: Sensor, fitted: Collection[int]) -> None:
    """Plan code 76 if every `sensor` in use is among `fitted`, or was calibrated before; else say why not."""
    kind = _KINDS[sensor]
    doubtful = [i for i in _used(draft, sensor) if i not in fitted and not _was_valid(draft, sensor, i)]
    if doubtful:
        draft.warn(
            f"{kind.one} {', '.join(str(i + 1) for i in doubtful)} is in use but was never calibrated, and not by this "
            "plan either; code 76 would mark it as calibrated, so it is not sent and the vehicle may refuse to arm. "
            f"Calibrate it, or set its {kind.use} to 0"
        )
    elif draft.options.mark_calibrated:
        draft.after(
            PREFLIGHT_CALIBRATION,
            kind.code,
            f"store the {kind.many}' ids, so that the vehicle takes them as calibrated and arms",
        )


def _used(draft: Draft, sensor: Sensor) -> list[int]:
    found = [i for (kind, i) in ardupilot.sensor_ids(draft.parameters) if kind == sensor]
    return sorted(i for i in found if int(draft.parameters.get(_use(draft, sensor, i), 1)) == 1)


def _use(draft: Draft, sensor: Sensor, instance: int) -> str:
    if sensor == Sensor.MAG:
        return names.ardupilot_compass_names(instance, instance)[Role.USE]
    return ardupilot.calibration_names(draft.parameters, sensor, instance)[Role.USE]


def _was_valid(draft: Draft, sensor: Sensor, instance: int) -> bool:
    """The firmware's own criterion: an offset that is not exactly zero; of an accelerometer no scale that is zero."""
    roles = ardupilot.calibration_names(draft.parameters, sensor, instance)
    offsets = [float(draft.parameters.get(roles[role], 0.0)) for role in names.OFFSET]
    scales = [float(draft.parameters.get(roles[role], 1.0)) for role in names.SCALE] if sensor == Sensor.ACCEL else []
    return any(offsets) and all(scales)
