"""Types shared by the API models; dataclasses of the domain that go over HTTP unchanged, with their docstrings."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from itertools import pairwise
from typing import Annotated, Any, cast

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, WithJsonSchema
from pydantic_core import CoreSchema, core_schema

from mavcal.calib.report import to_json

Json = dict[str, Any]

Number = Annotated[int | float, WithJsonSchema({"type": "number"})]
"""A number as the domain has it: an integer is not turned into a float on its way."""

Vector = Annotated[tuple[float, float, float], WithJsonSchema(
    {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3}
)]  # fmt: skip
"""Three numbers, along x, y and z."""

Attitude = Annotated[
    tuple[float, float, float, float],
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 4, "maxItems": 4}),
]
"""A quaternion w x y z."""

Stamp = Annotated[float, Field(description="wall-clock time, s since 1970")]


class Request(BaseModel):
    """The body of a request: a field that is not known is refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


_NUMBER, _INTEGER, _NULL = ({"type": name} for name in ("number", "integer", "null"))


class Wire:
    """The name that a dataclass has in the OpenAPI document; written as ``Annotated[Loss, Wire("LossModel")]``.

    ``calib.report`` writes its JSON. Docstrings of the class and its attributes describe it, with null for None.
    An answer has every field, whatever its default.

    Parameters
    ----------
    name
        The name, which programs know from the generated clients.
    lacking
        Fields that an earlier version of the service does not send.
    not_finite
        Numbers that may be infinite or not a number, which JSON has as null.
    """

    def __init__(self, name: str, *, lacking: tuple[str, ...] = (), not_finite: tuple[str, ...] = ()) -> None:
        self.name = name
        self._lacking = lacking
        self._not_finite = not_finite

    def __get_pydantic_core_schema__(self, kind: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        self._kind = kind
        written = core_schema.plain_serializer_function_ser_schema(to_json)
        return cast(CoreSchema, {**handler(kind), "serialization": written})

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Json:
        reference = handler(schema)
        schema = handler.resolve_ref_schema(reference)
        schema["properties"] = {name: self._property(name, part) for name, part in schema["properties"].items()}
        schema["required"] = [name for name in schema["properties"] if name not in self._lacking]
        schema["title"] = self.name
        schema["description"] = _null_for_none(inspect.getdoc(self._kind) or "")
        return reference

    def _property(self, name: str, part: Json) -> Json:
        schema = _plain(part)
        if name in self._not_finite:
            schema.pop("type", None)
            schema = {"anyOf": [_NUMBER, _NULL], **schema}
        if (text := _attribute_texts(self._kind.__module__, self._kind.__qualname__).get(name)) is not None:
            schema["description"] = text
        if "default" in schema and name not in self._lacking:
            del schema["default"]
        return schema


def _plain(part: Json) -> Json:
    """The schema with integer-or-number as number, and a tuple of equal types as a list of fixed length."""
    match part:
        case {"anyOf": [*among]} if _NUMBER in among and _INTEGER in among:
            left = [kind for kind in among if kind != _INTEGER]
            head, old = (left[0] if len(left) == 1 else {"anyOf": left}), "anyOf"
        case {"prefixItems": [first, *others]} if all(other == first for other in others):
            head, old = {"items": first}, "prefixItems"
        case _:
            return dict(part)
    return {**head, **{key: value for key, value in part.items() if key != old}}


@cache
def _attribute_texts(module: str, name: str) -> Mapping[str, str]:
    """The docstrings of attributes, as descriptions; empty if the source is not available."""
    return {attribute: _description(text) for attribute, text in _attribute_docstrings(_class(module, name))}


@cache
def _parsed(module: str) -> ast.Module:
    try:
        return ast.parse(inspect.getsource(sys.modules[module]))
    except OSError:
        return ast.Module([], [])


def _class(module: str, name: str) -> ast.ClassDef | None:
    body = _parsed(module).body
    return next((node for node in body if isinstance(node, ast.ClassDef) and node.name == name), None)


def _attribute_docstrings(found: ast.ClassDef | None) -> Iterator[tuple[str, str]]:
    for one, following in pairwise([] if found is None else found.body):
        match one, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, text


def _description(text: str) -> str:
    """A docstring as a phrase: without its full stop, and with a small first letter unless a name begins it."""
    sentence = _null_for_none(" ".join(text.split())).removesuffix(".")
    return sentence if sentence[1:2].isupper() else sentence[:1].lower() + sentence[1:]


def _null_for_none(text: str) -> str:
    return re.sub(r"\bNone\b", "null", text)
