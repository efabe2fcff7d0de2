"""Mutations of the code, one at a time, and whether its tests notice."""
