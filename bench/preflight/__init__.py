"""Faults for the preflight: each is put into simulated vehicles, and the right check has to fail, alone."""
