"""Choices, by the words that go over HTTP."""

# Written by scripts/generate-client from docs/openapi.json. Do not edit.

from __future__ import annotations

from enum import StrEnum


class Airframe(StrEnum):
    """The shape that a picture of a vehicle has."""

    MULTIROTOR = "multirotor"
    PLANE = "plane"
    BOAT = "boat"


class Autopilot(StrEnum):
    """The firmware family."""

    ARDUPILOT = "ardupilot"
    PX4 = "px4"
    OTHER = "other"


class CheckId(StrEnum):
    """Stable names of the checks, in the order of the report."""

    SENSORS_HEARD = "sensors_heard"
    GYRO_REST = "gyro_rest"
    GYRO_NOISE = "gyro_noise"
    ACCEL_FORCE = "accel_force"
    COMPASS_FIELD = "compass_field"
    COMPASS_DIRECTION = "compass_direction"
    ATTITUDE = "attitude"
    TEMPERATURE = "temperature"
    CALIBRATION_AGE = "calibration_age"
    SENSOR_IDS = "sensor_ids"
    PARAMETERS_CHANGED = "parameters_changed"
    MOTOR_COMPENSATION = "motor_compensation"
    VIBRATION = "vibration"
    ONBOARD_CALIBRATION = "onboard_calibration"
    ARMING_CHECKS = "arming_checks"
    VEHICLE_PREARM = "vehicle_prearm"


class FitStatus(StrEnum):
    """What may be done with a fit."""

    OK = "ok"
    PARTIAL = "partial"
    REFUSED = "refused"


class Fixable(StrEnum):
    """Kinds of jobs that want nothing but a vehicle at rest."""

    GYRO = "gyro"
    LEVEL = "level"


class Hand(StrEnum):
    """Who moves a simulated vehicle."""

    AUTO = "auto"
    MOUSE = "mouse"
    OFF = "off"


class Holds(StrEnum):
    """Which value a parameter holds."""

    OLD = "old"
    NEW = "new"
    OTHER = "other"
    UNKNOWN = "unknown"


class ItemOutcome(StrEnum):
    """What became of an item."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    WARNED = "warned"
    REVIEW = "review"
    REFUSED = "refused"
    SKIPPED = "skipped"
    FAILED = "failed"
    IN_DOUBT = "in_doubt"
    CANCELLED = "cancelled"


class JobState(StrEnum):
    """Where a job is."""

    QUEUED = "queued"
    RUNNING = "running"
    WAITING_FOR_OPERATOR = "waiting_for_operator"
    FITTING = "fitting"
    REVIEW = "review"
    APPLYING = "applying"
    WAITING_FOR_REBOOT = "waiting_for_reboot"
    VERIFYING = "verifying"
    SUCCEEDED = "succeeded"
    ROLLING_BACK = "rolling_back"
    REVERTED = "reverted"
    IN_DOUBT = "in_doubt"
    FAILED = "failed"
    CANCELLED = "cancelled"
    INTERRUPTED = "interrupted"


class Landed(StrEnum):
    """EXTENDED_SYS_STATE.landed_state."""

    UNDEFINED = "undefined"
    ON_GROUND = "on_ground"
    IN_AIR = "in_air"
    TAKEOFF = "takeoff"
    LANDING = "landing"


class LinkState(StrEnum):
    """Where a link stands; the reason is a sentence beside it."""

    CONNECTING = "connecting"
    UP = "up"
    DOWN = "down"
    CLOSED = "closed"


class LiveState(StrEnum):
    """State of a watch."""

    ASKING = "asking"
    GRANTED = "granted"
    WAITING = "waiting"


class ObservationSource(StrEnum):
    """Where a measurement comes from."""

    JOB = "job"
    PREFLIGHT = "preflight"


class ParameterKind(StrEnum):
    """The type that a parameter has on the wire."""

    REAL32 = "real32"
    INT32 = "int32"
    INT16 = "int16"
    INT8 = "int8"
    UINT8 = "uint8"
    UINT16 = "uint16"
    UINT32 = "uint32"


class Pose(StrEnum):
    """The six faces, in the order and meaning of MAVLink's ``ACCELCAL_VEHICLE_POS`` (1..6), and oblique poses."""

    LEVEL = "level"
    LEFT = "left"
    RIGHT = "right"
    NOSE_DOWN = "nose_down"
    NOSE_UP = "nose_up"
    BACK = "back"
    OBLIQUE = "oblique"


class PromptStep(StrEnum):
    """What a prompt is about, for programs: those of a capture, then those of a write."""

    HOLD_STILL = "hold_still"
    POSE = "pose"
    PLACE = "place"
    ROTATE = "rotate"
    TURN = "turn"
    WARM_UP = "warm_up"
    STATE = "state"
    PROVE = "prove"
    REBOOT = "reboot"
    WAIT = "wait"
    BUSY = "busy"
    SILENT = "silent"


class ProofLevel(StrEnum):
    """How much of what acts on a stream the stream has proved."""

    FULL = "full"
    PARTIAL = "partial"
    NONE = "none"


class ProofVerdict(StrEnum):
    """Verdict on one written parameter."""

    PROVED = "proved"
    CONSISTENT = "consistent"
    NOT_OBSERVABLE = "not_observable"
    CONTRADICTED = "contradicted"


class Quantity(StrEnum):
    """What a trend may leave undetermined."""

    TIME = "time"
    TEMPERATURE = "temperature"
    LEAVING = "leaving"


class ReasonCode(StrEnum):
    """Why a unit should be calibrated again."""

    NEVER = "never"
    AGE = "age"
    DRIFT = "drift"
    PREFLIGHT = "preflight"


class Sensor(StrEnum):
    """What a channel measures; the comment gives the columns and the unit."""

    ACCEL = "accel"
    GYRO = "gyro"
    MAG = "mag"
    TEMPERATURE = "temperature"
    CURRENT = "current"
    THROTTLE = "throttle"
    MOTOR = "motor"
    ROTOR_SPEED = "rotor_speed"
    ATTITUDE = "attitude"
    POSITION = "position"
    VELOCITY = "velocity"
    PLACE = "place"
    VIBRATION = "vibration"
    GYRO_VIBRATION = "gyro_vibration"
    CONTROL = "control"
    MIXER = "mixer"
    VOLTAGE = "voltage"
    HEIGHT = "height"
    AIR = "air"


class SensorCheckId(StrEnum):
    """What a sensor should read after a write."""

    GYRO_ZERO = "gyro_zero"
    ACCEL_GRAVITY = "accel_gravity"
    ACCEL_DIRECTION = "accel_direction"
    LEVEL = "level"
    ATTITUDE = "attitude"


class SensorVerdict(StrEnum):
    """Whether a sensor reads, after a write, what it should."""

    RIGHT = "right"
    WRONG = "wrong"
    NOT_OBSERVABLE = "not_observable"


class Verdict(StrEnum):
    """What a check, or a whole report, comes to."""

    PASS = "pass"
    WARN = "warn"
    FAIL = "fail"
    UNKNOWN = "unknown"


class WriteResult(StrEnum):
    """Result of the last attempt to write."""

    RUNNING = "running"
    FAILED = "failed"
    IN_DOUBT = "in_doubt"
    REVERTED = "reverted"
    SUCCEEDED = "succeeded"
