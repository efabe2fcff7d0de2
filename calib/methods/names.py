"""Names of the methods, each with its module and a line on what it finds; loading them loads no method."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class Entry(NamedTuple):
    """A line of the table."""

    module: str
    """Module of this package that has the method."""
    summary: str


ENTRIES: Mapping[str, Entry] = MappingProxyType(
    {
        "accel-one-axis": Entry("accel", "Accelerometer offset with one axis vertical"),
        "accel-six-face": Entry("accel", "Accelerometer offset and full matrix from six faces of a fixture"),
        "accel-multi": Entry("accel", "Accelerometer offset and matrix from still poses in any direction"),
        "accel-thermal": Entry("accel", "Accelerometer offset, matrix and drift with temperature from still poses"),
        "gyro-rest": Entry("gyro", "Gyroscope offset at rest"),
        "gyro-turntable": Entry("gyro", "Gyroscope scale, cross axes and offset from turns at a known rate"),
        "gyro-thread": Entry("gyro", "Gyroscope scale and offset from whole turns on a thread, each way"),
        "gyro-g-sensitivity": Entry("gyro", "What acceleration does to the gyroscope: offset + K acceleration"),
        "mag-minmax": Entry("mag", "Magnetometer offset and scale from the extremes"),
        "rest-reference": Entry("mag", "Reference vectors at rest, and the attitude that they imply"),
        "mag-sphere": Entry("mag", "Magnetometer offset by a sphere"),
        "mag-ellipsoid-axis": Entry("mag", "Magnetometer offset and axis scales by an axis-aligned ellipsoid"),
        "mag-ellipsoid": Entry("mag", "Magnetometer offset and symmetric matrix by orthogonal distance"),
        "mag-rings": Entry("mag", "Magnetometer offset, full matrix and mounting from six turns about the vertical"),
        "mag-align": Entry("mag", "Magnetometer offset, full matrix and mounting against the accelerometer"),
        "mag-gyro": Entry("mag", "Magnetometer offset, matrix and mounting against the gyroscope"),
        "mag-flight": Entry("mag_flight", "Magnetometer offset and soft iron from an ordinary flight"),
        "mag-motor": Entry("mag_flight", "Compensation of a magnetometer for the motors, from an ordinary flight"),
        "thermal-linear": Entry("thermal", "Slope of accelerometer and gyroscope against temperature"),
        "thermal-poly": Entry("thermal", "Polynomial drift of accelerometer and gyroscope against temperature"),
        "mag-thermal": Entry("thermal", "Drift of a magnetometer with temperature, and which axes repeat"),
        "imu-multi": Entry(
            "imu", "Accelerometer and gyroscope jointly, from still poses and the movements between them"
        ),
        "allan": Entry("noise", "White noise, bias instability and random walk by the Allan variance"),
    }
)
"""Every method by its name, in the order of the command line."""
