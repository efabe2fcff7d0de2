"""The parameters of the flying vehicle: ArduCopter's names, as far as they change how it flies or what is logged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from mavcal.service.simvehicle.errors import ConfigurationError
from mavcal.service.simvehicle.parameters import NAME_LENGTH, float32

_AXES = "XYZ"
_FIRMWARE: Mapping[str, float] = {
    "ARMING_CHECK": 1, "ATC_ACCEL_P_MAX": 110000, "ATC_ACCEL_R_MAX": 110000, "ATC_ACCEL_Y_MAX": 27000,
    "ATC_ANG_PIT_P": 4.5, "ATC_ANG_RLL_P": 4.5, "ATC_ANG_YAW_P": 4.5, "ATC_INPUT_TC": 0.15,
    "ATC_RAT_PIT_D": 0.0036, "ATC_RAT_PIT_I": 0.135, "ATC_RAT_PIT_P": 0.135,
    "ATC_RAT_RLL_D": 0.0036, "ATC_RAT_RLL_I": 0.135, "ATC_RAT_RLL_P": 0.135,
    "ATC_RAT_YAW_D": 0.0, "ATC_RAT_YAW_I": 0.02, "ATC_RAT_YAW_P": 0.3,
    "ANGLE_MAX": 3000, "BATT_MONITOR": 4, "DISARM_DELAY": 10, "FRAME_CLASS": 1, "FRAME_TYPE": 1, "GUID_TIMEOUT": 3,
    "INS_ACCEL_FILTER": 20, "INS_GYRO_FILTER": 20, "INS_USE": 1, "INS_USE2": 1,
    "LAND_ALT_LOW": 1000, "LAND_SPEED": 45, "LOG_BITMASK": 403189, "LOG_DISARMED": 1,
    "MOT_BAT_VOLT_MAX": 12.8, "MOT_BAT_VOLT_MIN": 9.6, "MOT_HOVER_LEARN": 2, "MOT_PWM_MAX": 2000, "MOT_PWM_MIN": 1000,
    "MOT_SPIN_ARM": 0.1, "MOT_SPIN_MAX": 0.95, "MOT_SPIN_MIN": 0.15, "MOT_THST_EXPO": 0.65, "MOT_THST_HOVER": 0.39,
    "PSC_VELXY_I": 1.0, "PSC_VELXY_P": 2.0, "PSC_VELZ_P": 5.0, "RNGFND1_TYPE": 0, "RTL_ALT": 1500,
    "SCHED_LOOP_RATE": 400, "WPNAV_ACCEL": 450, "WPNAV_ACCEL_Z": 300, "WPNAV_RADIUS": 200, "WPNAV_SPEED": 1000,
    "WPNAV_SPEED_DN": 400, "WPNAV_SPEED_UP": 450,
}  # fmt: skip
"""ArduCopter's names and defaults (4.7)."""
_SIMULATOR: Mapping[str, float] = {
    "SIM_BATT_VOLTAGE": 12.6, "SIM_ENGINE_FAIL": 0, "SIM_ENGINE_MUL": 1, "SIM_GPS1_ENABLE": 1, "SIM_OPOS_ALT": 584,
    "SIM_OPOS_HDG": 0, "SIM_OPOS_LAT": -35.363261, "SIM_OPOS_LNG": 149.16523, "SIM_SPEEDUP": 1,
    "SIM_WIND_DIR": 180, "SIM_WIND_SPD": 0, "SIM_WIND_T": 1, "SIM_WIND_TC": 5, "SIM_WIND_TURB": 0,
}  # fmt: skip
"""SITL's names and defaults. The wind is the same at all heights, as in SITL only with SIM_WIND_T 1."""
DEFAULTS: Mapping[str, float] = {
    **_FIRMWARE,
    **{f"SERVO{n}_FUNCTION": 32 + n for n in range(1, 5)},
    **{f"INS_ACC{n}OFFS_{a}": 0.0 for n in ("", "2") for a in _AXES},
    **{f"INS_ACC{n}SCAL_{a}": 1.0 for n in ("", "2") for a in _AXES},
    **{f"INS_GYR{n}OFFS_{a}": 0.0 for n in ("", "2") for a in _AXES},
    **{f"INS_{s}{n}_ID": 2752772 + 8 * k for k, (s, n) in enumerate((s, n) for s in ("GYR", "ACC") for n in ("", "2"))},
    **{f"COMPASS_{what}_{a}": value for what, value in (("OFS", 0), ("DIA", 1), ("ODI", 0)) for a in _AXES},
    "COMPASS_USE": 1,
    "COMPASS_DEV_ID": 97539,
    "COMPASS_EXTERNAL": 1,
    "COMPASS_ORIENT": 0,
    "COMPASS_SCALE": 1,
    **_SIMULATOR,
    **{f"SIM_ACC{n}_SCAL_{a}": 1.0 for n in (1, 2) for a in _AXES},
    **{f"SIM_ACC{n}_BIAS_{a}": 0.0 for n in (1, 2) for a in _AXES},
    **{f"SIM_ACC{n}_RND": 0.0 for n in (1, 2)},
    **{f"SIM_GYR{n}_SCALE_{a}": 0.0 for n in (1, 2) for a in _AXES},
    **{f"SIM_GYR{n}_BIAS_{a}": 0.0 for n in (1, 2) for a in _AXES},
    **{f"SIM_GYR{n}_RND": 0.0 for n in (1, 2)},
}


class FlightParameters:
    """Values by name, in the order in which they are listed; a change counts up `version`."""

    def __init__(self, given: Mapping[str, float] | None = None) -> None:
        self._values = {name: float32(value) for name, value in sorted(DEFAULTS.items())}
        self.version = 0
        for name, value in (given or {}).items():
            self._values[name] = float32(value)

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def vector(self, base: str) -> tuple[float, float, float]:
        """The values of base_X, base_Y, base_Z."""
        return self._values[f"{base}_X"], self._values[f"{base}_Y"], self._values[f"{base}_Z"]

    def store(self, name: str, value: float) -> bool:
        """Change a value that exists; False: there is none of that name."""
        if name not in self._values:
            return False
        self._values[name] = float32(value)
        self.version += 1
        return True


def load_parameters(path: str | Path) -> dict[str, float]:
    """Parameters of a file with `NAME VALUE` or `NAME,VALUE` lines; # begins a comment.

    Names unknown to this vehicle are kept and listed, without effect, like a firmware's own.

    Raises ConfigurationError naming the broken line.
    """
    found: dict[str, float] = {}
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise ConfigurationError(f"parameter file {path} cannot be read: {error.strerror}") from error
    for number, line in enumerate(lines, start=1):
        parts = line.partition("#")[0].replace(",", " ").split()
        if not parts:
            continue
        try:
            name, value = parts[0], float(parts[1])
        except (IndexError, ValueError) as error:
            raise ConfigurationError(f"{path}, line {number}: needs NAME VALUE, got {line.strip()!r}") from error
        if len(name) > NAME_LENGTH:
            raise ConfigurationError(f"{path}, line {number}: a name has at most {NAME_LENGTH} characters: {name}")
        found[name] = value
    return found
