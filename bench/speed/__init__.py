"""Speed beside peers, start-up and memory: ``python -m bench.speed``."""
