"""The generated client and types are those of the document, and every operation is in both."""

from __future__ import annotations

import inspect
import json
from pathlib import Path

import pytest

from mavcal.client import AsyncClient, Client
from scripts.client import __main__ as generator
from scripts.client.python import _type
from scripts.client.spec import Document, references, sentence

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def document() -> Document:
    return Document(json.loads((ROOT / "docs" / "openapi.json").read_text()))


def test_the_generated_files_are_up_to_date() -> None:
    assert generator.outdated() == [], "run scripts/generate-client"


def test_every_operation_is_a_method_of_both_clients(document: Document) -> None:
    assert len(document.operations) > 35
    types = (ROOT / "web" / "mavcal.d.ts").read_text()
    for operation in document.operations:
        waiting, asynchronous = (getattr(c, operation.name) for c in (Client, AsyncClient))
        assert waiting.__doc__ == asynchronous.__doc__
        wanted = {"self", *(p.name for p in operation.parameters), *(["content"] if operation.raw else [])}
        for method in (waiting, asynchronous):
            parameters = inspect.signature(method).parameters
            assert set(parameters) == wanted
            needed = {name for name, p in parameters.items() if p.default is p.empty} - {"self", "content"}
            assert needed == {p.name for p in operation.parameters if p.required}
        assert f"\n  {operation.name}: {{" in types


def test_every_schema_that_is_answered_is_a_type(document: Document) -> None:
    types = (ROOT / "web" / "mavcal.d.ts").read_text()
    python = "".join(path.read_text() for path in (ROOT / "client").glob("*.py"))
    for name in document.reached(*(r for o in document.operations for r in references(o.answer))):
        assert f"class {name}(" in python or f"\n{name} = " in python, name
        assert f"interface {name} " in types or f"type {name} " in types, name


@pytest.mark.parametrize(
    ("schema", "kind"),
    [
        ({"type": "integer"}, "int"),
        ({"anyOf": [{"type": "number"}, {"type": "null"}]}, "Number | None"),
        ({"type": "array", "prefixItems": [{"type": "string"}, {"type": "integer"}]}, "tuple[str, int]"),
        ({"type": "object", "additionalProperties": {"type": "boolean"}}, "dict[str, bool]"),
        ({"const": "state"}, "Literal['state']"),
        ({}, "Any"),
    ],
)
def test_a_schema_as_a_type(schema, kind) -> None:
    assert _type(schema) == kind


def test_a_sentence() -> None:
    assert sentence("in  `unit`;\n null: none") == "In `unit`; null: none."


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("how many there\n are", "How many there are."),
        ("a row an axis", "A row an axis."),
        ("wall-clock time, s", "Wall-clock time, s."),
        ("degC; null: any", "degC; null: any."),
        ("s of the vehicle's clock", "s of the vehicle's clock."),
        ("offset_x, matrix_xy", "offset_x, matrix_xy."),
        ("`after` of the next page", "`after` of the next page."),
        ("Done?", "Done?"),
    ],
)
def test_a_description_is_a_sentence_whose_names_and_units_keep_their_letters(text: str, told: str) -> None:
    assert sentence(text) == told
