"""Calibration of a gyroscope alone: at rest, on a turntable, hung on a thread, and its g-sensitivity."""
