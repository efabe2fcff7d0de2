"""The OpenAPI document as the emitters read it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

Json = Mapping[str, Any]
METHODS = ("get", "post", "patch", "delete")


@dataclass(frozen=True)
class Parameter:
    """A parameter of an operation, or a field of its body, by its name in the code and on the wire."""

    name: str
    wire: str
    place: str
    """``path``, ``query``, ``header`` or ``body``."""
    schema: Json
    required: bool
    text: str = ""

    @property
    def document(self) -> bool:
        """Whether it is a JSON document in the query."""
        return self.place == "query" and "$ref" in self.schema


@dataclass(frozen=True)
class Operation:
    """One operation."""

    name: str
    method: str
    path: str
    summary: str
    text: str
    parameters: tuple[Parameter, ...]
    body: str | None
    """Name of the schema of its JSON body; None: there is none."""
    raw: bool
    """Whether its body is a file."""
    answer: Json | None
    """Schema of its answer; None: there is none."""
    stream: bool
    """Whether it answers with an event stream, whose messages are of `answer`."""
    plain: bool
    """Whether it answers with text."""
    also: tuple[int, ...]
    """Statuses that are no problems, although they are errors."""

    @property
    def resumes(self) -> bool:
        """Whether its stream can be continued where it broke."""
        return any(p.wire == "Last-Event-ID" for p in self.parameters)


class Document:
    """The schemas and operations of a document."""

    def __init__(self, document: Json) -> None:
        self.schemas: Json = document["components"]["schemas"]
        self.operations = tuple(self._operations(document["paths"]))

    def enums(self) -> list[str]:
        """Schemas that are a choice of strings."""
        return [name for name, schema in self.schemas.items() if "enum" in schema and not is_code(name)]

    def codes(self) -> dict[str, str]:
        """Every problem code and what it means."""
        schema = self.schemas["ProblemCode"]
        return dict(zip(schema["enum"], schema["x-enum-descriptions"], strict=True))

    def models(self) -> list[str]:
        """Schemas that become types, each after those that it is made of."""
        found: list[str] = []

        def visit(name: str) -> None:
            if name in found:
                return
            for other in references(self.schemas[name]):
                visit(other)
            found.append(name)

        for name in self.schemas:
            visit(name)
        return [name for name in found if "enum" not in self.schemas[name] and not is_status(name)]

    def reached(self, *names: str) -> set[str]:
        """`names`, and every schema that they are made of."""
        found: set[str] = set()
        pending = list(names)
        while pending:
            name = pending.pop()
            if name not in found:
                found.add(name)
                pending += references(self.schemas[name])
        return found

    def requests(self) -> set[str]:
        """Schemas that arguments have."""
        asked = [r for o in self.operations for p in o.parameters for r in references(p.schema)]
        return {name for name in self.reached(*asked) if name in set(self.models())}

    def events(self) -> set[str]:
        """Schemas that only streams carry."""
        streamed = [r for o in self.operations if o.stream for r in references(o.answer)]
        told = [r for o in self.operations if not o.stream for r in references(o.answer)]
        return self.reached(*streamed) - self.reached(*told)

    def _operations(self, paths: Json) -> Iterator[Operation]:
        for path, methods in paths.items():
            for method in METHODS:
                if method in methods:
                    yield self._operation(path, method, methods[method])

    def _operation(self, path: str, method: str, raw: Json) -> Operation:
        status, answer = next((s, a) for s, a in sorted(raw["responses"].items()) if s.startswith("2"))
        kinds = answer.get("content", {})
        stream, plain = "text/event-stream" in kinds, set(kinds) != {"application/json"}
        also = [
            int(s) for s, a in raw["responses"].items() if s > "399" and "application/problem+json" not in a["content"]
        ]
        body = raw.get("requestBody", {}).get("content", {})
        of_body = body.get("application/json", {}).get("schema")
        ref = None if of_body is None else next(iter(references(of_body)))
        parameters = sorted(
            (_parameter(p) for p in raw.get("parameters", ())), key=lambda p: path.find(f"{{{p.wire}}}")
        )
        if ref is not None:
            fields, needed = self.schemas[ref]["properties"], self.schemas[ref].get("required", ())
            parameters += [_field(name, schema, name in needed) for name, schema in fields.items()]
        return Operation(
            name=raw["operationId"],
            method=method.upper(),
            path=path,
            summary=raw["summary"],
            text=raw.get("description", ""),
            parameters=tuple(parameters),
            body=ref,
            raw="application/octet-stream" in body,
            answer=None if status == "204" else next(iter(kinds.values())).get("schema", {}),
            stream=stream,
            plain=plain and not stream,
            also=tuple(also),
        )


def _parameter(raw: Json) -> Parameter:
    schema = raw["schema"] if "schema" in raw else raw["content"]["application/json"]["schema"]
    name = raw["name"].lower().replace("-", "_")
    text = raw.get("description", schema.get("description", ""))
    return Parameter(name, raw["name"], raw["in"], schema, raw.get("required", False), text)


def _field(name: str, schema: Json, required: bool) -> Parameter:
    return Parameter(name, name, "body", schema, required, schema.get("description", ""))


def references(schema: Any) -> list[str]:
    """Names of the schemas that a schema names itself, in their order."""
    if isinstance(schema, Mapping):
        own = [schema["$ref"].rsplit("/", 1)[1]] if "$ref" in schema else []
        found = [*own, *(name for key, part in schema.items() if key != "discriminator" for name in references(part))]
    elif isinstance(schema, list):
        found = [name for item in schema for name in references(item)]
    else:
        found = []
    return list(dict.fromkeys(found))


def is_status(name: str) -> bool:
    """Whether a schema is a problem of one status."""
    return re.fullmatch(r"Problem\d{3}", name) is not None


def is_code(name: str) -> bool:
    """Whether a schema is that of the problem codes."""
    return name == "ProblemCode"


def sentence(text: str) -> str:
    """`text` as a sentence, on one line. What is written as a name or a unit keeps its letters."""
    line = " ".join(text.split())
    first = re.split(r"[\s,;:]", line, maxsplit=1)[0]
    if re.fullmatch("a|[a-z]{2,}(-[a-z]+)*", first):
        line = line[:1].upper() + line[1:]
    return line if not line or line[-1] in ".!?" else f"{line}."
