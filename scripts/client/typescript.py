"""TypeScript types: one for each schema, and one entry for each operation."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import Any

from scripts.client.spec import Document, Operation, is_status, sentence

HEAD = """// Written by scripts/generate-client from docs/openapi.json. Do not edit.
//
// Types of what the service takes and tells. A program that uses it needs no more than fetch and EventSource.
"""
PRIMITIVES = {"string": "string", "number": "number", "integer": "number", "boolean": "boolean", "null": "null"}


def emit(document: Document) -> str:
    """The text of ``web/mavcal.d.ts``."""
    parts = [HEAD]
    for name in sorted(document.schemas):
        if not is_status(name):
            parts.append(_named(name, document.schemas[name]))
    parts.append("/** Every operation by its id: what it takes and what it answers with. */")
    parts.append("export interface Operations {")
    for operation in document.operations:
        parts.append(_operation(operation))
    parts.append("}")
    return "\n".join(parts) + "\n"


def _named(name: str, schema: Mapping[str, Any]) -> str:
    head = _comment(schema.get("description", ""), "")
    if schema.get("type") == "object" and "properties" in schema:
        return f"{head}export interface {name} {_object(schema, '')}\n"
    return f"{head}export type {name} = {_type(schema)};\n"


def _object(schema: Mapping[str, Any], indent: str) -> str:
    lines = ["{"]
    for name, field in schema.get("properties", {}).items():
        lines.append(_comment(field.get("description", ""), f"{indent}  ").rstrip("\n"))
        optional = "" if name in schema.get("required", ()) else "?"
        lines.append(f"{indent}  {_key(name)}{optional}: {_type(field)};")
    return "\n".join([line for line in lines if line] + [f"{indent}}}"])


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        return str(schema["$ref"].rsplit("/", 1)[1])
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " | ".join(json.dumps(value) for value in schema["enum"])
    for key in ("anyOf", "oneOf"):
        if key in schema:
            return " | ".join(_type(option) for option in schema[key])
    kind = schema.get("type")
    if kind == "array":
        if "prefixItems" in schema:
            return f"[{', '.join(_type(item) for item in schema['prefixItems'])}]"
        return _array(schema)
    if kind == "object":
        extra = schema.get("additionalProperties", True)
        if extra is False:
            return "Record<string, never>"
        return "Record<string, unknown>" if extra is True else f"Record<string, {_type(extra)}>"
    return PRIMITIVES.get(kind or "", "unknown")


def _array(schema: Mapping[str, Any]) -> str:
    item = _type(schema.get("items", {}))
    least, most = schema.get("minItems"), schema.get("maxItems")
    if least is not None and least == most:
        return f"[{', '.join([item] * least)}]"
    return f"({item})[]" if " | " in item else f"{item}[]"


def _operation(operation: Operation) -> str:
    lines = [_comment(operation.summary, "  ").rstrip("\n"), f"  {operation.name}: {{"]
    lines.append(f"    method: {json.dumps(operation.method)};")
    lines.append(f"    path: {json.dumps(operation.path)};")
    for place in ("path", "query", "header"):
        chosen = [p for p in operation.parameters if p.place == place]
        if chosen:
            fields = [f"{_key(p.wire)}{'' if p.required else '?'}: {_type(p.schema)}" for p in chosen]
            lines.append(f"    {'parameters' if place == 'path' else place}: {{ {'; '.join(fields)} }};")
    if operation.body is not None:
        lines.append(f"    body: {operation.body};")
    if operation.raw:
        lines.append("    body: Blob;")
    told = "null" if operation.answer is None else "string" if operation.plain else _type(operation.answer)
    lines.append(f"    {'message' if operation.stream else 'answer'}: {told};")
    return "\n".join([*lines, "  };"])


def _key(name: str) -> str:
    return name if re.fullmatch("[A-Za-z_][A-Za-z0-9_]*", name) else json.dumps(name)


def _comment(text: str, indent: str) -> str:
    return f"{indent}/** {sentence(text)} */\n" if text else ""
