"""Calibration procedures: raw samples in; prompts, progress and fits out.

:mod:`~calib.procedures.registry` lists them, makes one and runs one over a recording.
"""
