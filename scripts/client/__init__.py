"""Writes the Python client and the TypeScript types from ``docs/openapi.json``; ``scripts/generate-client``."""
