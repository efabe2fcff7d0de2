"""The mission that a log holds: `items` -> `course` (where it flies, how long) -> `reading`."""
