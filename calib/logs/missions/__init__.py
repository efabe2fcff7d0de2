"""The mission in a log: `items` -> `course` (positions and durations) -> `reading`."""
