"""Held-out blocks: whether they confirm an effect, and how far the gap shrinks on them."""
