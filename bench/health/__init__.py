"""Faults put into healthy logs: which are found, and what is called bad that is not: ``python -m bench.health``."""
