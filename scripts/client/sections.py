"""The directions that a coverage mask counts, as the panel draws them."""

from __future__ import annotations

from mavcal.calib.mag.coverage import CENTRES

HEAD = """// Written by scripts/generate-client from calib/mag/coverage.py. Do not edit.
//
// Middles of the 80 sections of a coverage mask: unit vectors (front, right, down).
// Section i is bit i % 8 of byte i // 8.

/** @type {readonly (readonly [number, number, number])[]} */
export const SECTIONS = [
"""


def emit() -> str:
    """The text of ``web/scene/sections.js``."""
    return HEAD + "".join(f"  [{x:.4f}, {y:.4f}, {z:.4f}],\n" for x, y, z in CENTRES) + "];\n"
