"""Examples in cells (``# %%``) that run as scripts; ``docs/library.md`` shows what they print and draw."""
