"""Fits and diagnoses of uploaded recordings, as jobs without a vehicle."""
