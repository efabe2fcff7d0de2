"""The catalogue: every effect that can be named, one family a file."""
