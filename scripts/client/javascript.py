"""The table that the panel calls the service by: method and path of each operation."""

from __future__ import annotations

import json

from scripts.client.spec import Document

HEAD = """// Written by scripts/generate-client from docs/openapi.json. Do not edit.
//
// Method and path of every operation; their types are `Operations` of mavcal.d.ts.

/** @type {{ [K in keyof import("./mavcal.d.ts").Operations]: readonly [string, string] }} */
export const OPERATIONS = {
"""


def emit(document: Document) -> str:
    """The text of ``web/operations.js``."""
    lines = [
        f"  {operation.name}: {json.dumps([operation.method, operation.path])},\n" for operation in document.operations
    ]
    return HEAD + "".join(lines) + "};\n"
