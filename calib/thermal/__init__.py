"""Drift with temperature: one sensor's curve, and an accelerometer's poses and temperature together."""
