"""The gyroscope alone: at rest, on a turntable, on a thread, and its g-sensitivity."""
