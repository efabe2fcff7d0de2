"""One module a command; each has a `command` that :mod:`service.cli` loads by name."""
