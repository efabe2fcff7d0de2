"""Synthetic recordings whose truth is known: sensor errors, motions, and other simulators' parameters.

>>> import numpy as np
>>> rng = np.random.default_rng(1)
>>> motion = motion_of("six-faces", MotionOptions(), rng)
>>> path = trajectory(motion.legs, 50.0, field=np.array([20.0, 0.0, 43.0]), start=motion.start)
>>> made = simulate(path, SensorSuite(accel=SensorErrors(bias=[0.1, 0.0, 0.0])), rng)
>>> made.recording.channel(Sensor.ACCEL).values[0].round(3)
array([ 0.1  ,  0.   , -9.807])
"""

from mavcal.calib.recording import Sensor
from mavcal.calib.simulate.matlab import MatlabParameters, from_matlab, to_matlab
from mavcal.calib.simulate.motion import Leg, SegmentFacts, Trajectory, Warming, along, trajectory
from mavcal.calib.simulate.presets import MOTIONS, MotionOptions, MotionPreset, motion_of
from mavcal.calib.simulate.recording import SensorSuite, Simulated, in_frame, simulate, suite_in_frame
from mavcal.calib.simulate.sensor import SensorErrors
from mavcal.calib.simulate.sitl import SitlParameters, SitlSensors, from_sitl, to_sitl

__all__ = [
    "MOTIONS",
    "Leg",
    "MatlabParameters",
    "MotionOptions",
    "MotionPreset",
    "SegmentFacts",
    "Sensor",
    "SensorErrors",
    "SensorSuite",
    "Simulated",
    "SitlParameters",
    "SitlSensors",
    "Trajectory",
    "Warming",
    "along",
    "from_matlab",
    "from_sitl",
    "in_frame",
    "motion_of",
    "simulate",
    "suite_in_frame",
    "to_matlab",
    "to_sitl",
    "trajectory",
]
