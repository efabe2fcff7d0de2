"""Recordings from the messages of a vehicle."""
