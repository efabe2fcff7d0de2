"""Traits of effects, and terms of the sensor equation; the diagnosis uses them instead of parts of an id."""

from __future__ import annotations

from enum import Enum


class Trait(Enum):
    """A property of an effect that is the same on every sensor."""

    BROADBAND = "noise of no single frequency, whose power is that of the whole recording or follows the rotors"
    WANDERING = "noise that wanders: it can stand for any slow change of the mean"
    LINE = "a line in the spectrum that the motors make"
    TONAL = "a wave of one frequency, which is its shape"
    JUMPING = "an event: an offset that comes at a moment, which is its shape"
    LEVEL = "it shifts the level of a reading, as temperature does, and what happens once"
    THERMAL = "it goes with the temperature"
    STEADY = "another recording of the same vehicle shows it alike: not temperature, current or an event"
    SIZE = "it makes the reference's movement larger or smaller"
    COARSE = "it rounds the samples to levels"
    DEAD_BAND = "small readings are zero, as they are on coarse levels"
    OUTSIDE = "it is around the vehicle: every instance of the sensor sees it"
    GROWING = "it grows evenly with time: what warms up evenly cannot be told from it"
    LATE = "its shape is how late readings come, in seconds"


class SensorTerm(Enum):
    """The field of :class:`SensorErrors` that an effect changes, and that exports write."""

    BIAS = "offset of an inertial sensor"
    HARD_IRON = "offset of a magnetometer"
    SCALE = "diagonal of the matrix"
    MISALIGNMENT = "matrix beside its diagonal"
    SOFT_IRON = "symmetric matrix of a magnetometer"
    ROTATION = "matrix of a rotation"
    TEMPERATURE_CURVE = "offset that follows the temperature, a polynomial about a reference temperature"
    TEMPERATURE_SCALE = "scale that follows the temperature about a reference temperature"
    THERMAL_LAG = "time by which the sensor is behind the thermometer"
    G_SENSITIVITY = "rate that follows the specific force"
    WHITE_NOISE = "noise density"
    FLICKER = "bias instability"
    RANDOM_WALK = "random walk of the offset"
    RESOLUTION = "step of the samples"
    FULL_SCALE = "end of the range"
