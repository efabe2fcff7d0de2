"""Sensor health from any flight, without a rest or a reference.

Every sensor and unit gets a verdict with its numbers, limits and the next action. What the log cannot show is said.
Values are judged with the calibration in force, as the autopilot took them.
"""
