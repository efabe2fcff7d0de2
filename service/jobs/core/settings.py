"""Times and limits of the job engine. Wall-clock seconds, except where the vehicle's clock is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


@dataclass(frozen=True)
class JobSettings:
    """Time limits of the engine."""

    settle_s: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({"ardupilot": 1.2, "px4": 6.0}))
    """From the last echo to the read-back, by the vehicle's clock where that runs faster than ours.

    ArduPilot saves in an I/O thread within 1 s; PX4 saves after 0.3 to 2 s, and its ``gyro_calibration`` rewrites
    CAL_GYRO0 5 s after the last change (FLIGHT_CONTROLLERS 3.1, 10).
    """
    save_s: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({"ardupilot": 1.2, "px4": 3.0}))
    """The same before a restart: what was written must be saved then, and what rewrites it is looked for afterwards."""
    settle_least_s: float = 0.3
    """Least such time on our clock, s: a PARAM_SET may still be under way."""
    check_s: float = 3.0
    """Length of the stream windows before and after a write, seconds of the vehicle's clock."""
    observe_s: float = 20.0
    """How much longer a check lasts that saw no sensor at rest, or finds one wrong; by the vehicle's clock."""
    window_timeout_s: float = 20.0
    """How long such a window may take."""
    measure_s: float = 2.0
    """How long the streams of a capture are measured before it begins, by the vehicle's time stamps."""
    gap_limit_s: float = 60.0
    """How long a capture outlives the loss of its vehicle."""
    return_limit_s: float = 60.0
    """How long a job waits after a restart of the service for its vehicle to come back."""
    recovery_alone_s: float = 5.0
    """How long other jobs wait at a start while interrupted writes are finished or taken back."""
    reboot_timeout_s: float = 60.0
    """From our restart command until the vehicle answers again."""
    operator_reboot_s: float = 1800.0
    """How long the operator has to restart the vehicle."""
    same_boot_s: float = 3.0
    """How long the vehicle's clock is awaited before a failure is taken as not due to a restart."""
    busy_s: float = 60.0
    """How long a job or a write waits for a calibration that the vehicle runs by itself, say after its start."""
    started_s: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({"px4": 10.0}))
    """Time after its start, by its own clock, during which a vehicle is not calibrated. PX4 silently calibrates its
    gyros in its first seconds (FLIGHT_CONTROLLERS 10)."""
    stall_s: float = 30.0
    """How long a capture waits for inertial data while the vehicle's heartbeat is there."""
    review_s: float = 10.0
    """How long a plan may wait for its accept until the vehicle's own message rates are put back."""
    preflight_s: float = 6.0
    """Length of a preflight's capture."""
    watch_s: float = 0.1
    """Period of the look at preconditions while something is under way."""
    retry_s: float = 2.0
    """Time between two attempts to resolve a job in doubt."""
    last_save_s: float = 5.0
    """How long a service that ends tries to save what its store has refused."""
    fits_at_once: int = 8
    """Most fits of uploads at a time; reading uploads needs processes as well."""
    diagnoses_at_once: int = 1
    """Most gap diagnoses at a time, so that fits find a free process."""
    progress_s: float = 0.5
    """Least time between two progress events of a job."""
