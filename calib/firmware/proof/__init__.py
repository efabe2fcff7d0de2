"""Whether what was written took effect: a new stream judged under the old and the new values."""
