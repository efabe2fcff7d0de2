"""``docs/methods.md`` and its pictures: ``python -m bench.guide``."""
