"""The job as a value, its journal, its store and its task."""
