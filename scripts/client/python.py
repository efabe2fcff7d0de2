"""The Python client: enums, models, problems, and one method for each operation, waiting and asynchronous."""

from __future__ import annotations

import itertools
import json
import keyword
import re
import textwrap
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

from scripts.client.spec import Document, Operation, Parameter, references, sentence

ROOT = Path(__file__).resolve().parents[2]
MARK = "# Written by scripts/generate-client from docs/openapi.json. Do not edit."
TRANSPORT_MARK = "# Written by scripts/generate-client from client/transport.py. Do not edit."
PRIMITIVES = {"string": "str", "number": "Number", "integer": "int", "boolean": "bool", "null": "None"}
WIDTH = 116


def emit(document: Document) -> dict[str, str]:
    """The text of each generated module of ``client/``, not yet formatted."""
    models = document.models()
    of = _modules(document)
    requests, events, told, job = ([n for n in models if n in of[m]] for m in ("requests", "events", "models", "jobs"))
    asynchronous = _client(document)
    return {
        "enums.py": _enums(document),
        "requests.py": _models("What is asked of the service.", document, requests, {}, "Request"),
        "jobs.py": _models("Jobs, and what they are made of.", document, job, {}, "Answer"),
        "models.py": _models("What the service answers with besides jobs.", document, told, {"jobs": job}, "Answer"),
        "events.py": _models(
            "What the event streams carry.",
            document,
            events,
            {"jobs": job, "models": told},
            "Answer",
        ),
        "problems.py": _problems(document),
        "waiting.py": _waiting(asynchronous),
        "waiting_transport.py": _waiting_transport(),
        "asynchronous.py": asynchronous,
    }


# --- schemas


def _enums(document: Document) -> str:
    lines = _head("Choices, by the words that go over HTTP.", "from enum import StrEnum")
    for name in sorted(document.enums()):
        schema = document.schemas[name]
        lines += ["", "", f"class {name}(StrEnum):", *_docstring(schema.get("description", name)), ""]
        lines += [f"    {_constant(value)} = {json.dumps(value)}" for value in schema["enum"]]
    return _text(lines)


def _models(about: str, document: Document, names: list[str], beside: Mapping[str, list[str]], base: str) -> str:
    body: list[str] = []
    shared = {union: _shared(document, union) for union in names if "oneOf" in document.schemas[union]}
    bases = {member: union for union in shared for member in _members(document, union) if shared[union]}
    written = set()
    for name in names:
        union = bases.get(name)
        if union is not None and union not in written:
            written.add(union)
            body += ["", "", f"class Any{union}({base}):", f'    """What every {union} has."""', ""]
            body += _fields(document.schemas[name], shared[union])
        body += [
            "",
            "",
            *_model(name, document.schemas[name], base if union is None else f"Any{union}", shared.get(union, ())),
        ]
    used = set(re.findall(r"\b\w+\b", "\n".join(body)))
    imports = []
    if "Any" in used or "Annotated" in used or "Literal" in used:
        imports.append(f"from typing import {', '.join(sorted(used & {'Annotated', 'Any', 'Literal'}))}")
    if "Field" in used:
        imports.append("from pydantic import Field")
    imports.append(f"from mavcal.client.base import {', '.join(sorted({base} | (used & {'Number'})))}")
    for module, known in {"enums": document.enums(), **beside}.items():
        chosen = sorted(used & set(known))
        if chosen:
            imports.append(f"from mavcal.client.{module} import {', '.join(chosen)}")
    return _text([*_head(about, *imports), *body])


def _members(document: Document, union: str) -> list[str]:
    """The models of which a union is one."""
    return [option["$ref"].rsplit("/", 1)[1] for option in document.schemas[union]["oneOf"]]


def _shared(document: Document, union: str) -> list[str]:
    """The fields with which every model of a union begins, if there are two or more."""
    schemas = [document.schemas[member] for member in _members(document, union)]
    fields = zip(*(schema["properties"].items() for schema in schemas), strict=False)
    found = [among[0][0] for among in itertools.takewhile(lambda among: all(f == among[0] for f in among), fields)]
    return found if len(found) > 1 else []


def _model(name: str, schema: Mapping[str, Any], base: str, inherited: Collection[str] = ()) -> list[str]:
    if "oneOf" in schema:
        return [f"{name} = {_type(schema)}", *_docstring(schema.get("description", f"One of {name}"), indent="")]
    lines = [f"class {name}({base}):", *_docstring(schema.get("description", name)), ""]
    return lines + _fields(schema, [field for field in schema.get("properties", {}) if field not in inherited])


def _fields(schema: Mapping[str, Any], fields: Iterable[str]) -> list[str]:
    lines = []
    for field in fields:
        of_field = schema["properties"][field]
        needed = field in schema.get("required", ())
        lines.append(f"    {field}: {_type(of_field)}{'' if needed else _default(of_field)}")
        if "description" in of_field:
            lines += _docstring(of_field["description"])
    return lines


def _default(schema: Mapping[str, Any]) -> str:
    value = schema.get("default")
    if isinstance(value, str | int | float):
        return f" = {value!r}"
    if "None" in _type(schema):
        return " = None"
    maker = {"object": "dict", "array": "list"}.get(schema.get("type", ""), _type(schema))
    return f" = Field(default_factory={maker})"


def _type(schema: Mapping[str, Any]) -> str:
    if "$ref" in schema:
        name = str(schema["$ref"].rsplit("/", 1)[1])
        return "str" if name == "ProblemCode" else name
    if "const" in schema:
        return f"Literal[{schema['const']!r}]"
    if "enum" in schema:
        return f"Literal[{', '.join(repr(value) for value in schema['enum'])}]"
    if "oneOf" in schema:
        options = " | ".join(_type(option) for option in schema["oneOf"])
        return f'Annotated[{options}, Field(discriminator="{schema["discriminator"]["propertyName"]}")]'
    if "anyOf" in schema:
        return " | ".join(dict.fromkeys(_type(option) for option in schema["anyOf"]))
    if schema.get("type") == "array":
        items = [_type(item) for item in schema.get("prefixItems", ())]
        return f"tuple[{', '.join(items)}]" if items else f"list[{_type(schema.get('items', {}))}]"
    if schema.get("type") == "object":
        extra = schema.get("additionalProperties", True)
        return f"dict[str, {_type(extra) if isinstance(extra, Mapping) else 'Any'}]"
    return PRIMITIVES.get(schema.get("type", ""), "Any")


# --- problems


def _problems(document: Document) -> str:
    lines = _head(
        "An exception for each problem that the service answers with.",
        "from collections.abc import Mapping",
        "from mavcal.client.errors import ApiProblem",
    )
    names = {code: "".join(part.capitalize() for part in code.split("-")) for code in document.codes()}
    for code, text in document.codes().items():
        lines += ["", "", f"class {names[code]}(ApiProblem):", *_docstring(text)]
    lines += ["", "", "PROBLEMS: Mapping[str, type[ApiProblem]] = {"]
    lines += [f"    {json.dumps(code)}: {name}," for code, name in names.items()]
    return _text([*lines, "}", '"""Each by its code."""'])


# --- operations


def _modules(document: Document) -> dict[str, set[str]]:
    """Which module has which types."""
    models, requests, events = set(document.models()), document.requests(), document.events()
    jobs = document.reached("JobModel") & models
    told = document.reached(*(r for o in document.operations if not o.stream for r in references(o.answer))) & models
    return {"jobs": jobs, "models": told - jobs, "events": events, "requests": requests}


WAITING = (
    ("waits for nothing", "waits for each answer"),
    (r"\b(async|await) ", ""),
    (r"\bimport asyncio\n", ""),
    (r"\basyncio\.sleep\b", "time.sleep"),
    (r"\bAsync(?=[A-Z])", ""),
    (r"\b(__)?a(?=enter__|exit__|close\(|read\(|iter_bytes\()", r"\1"),
    (r"\bfor found in (.+):\n +yield found", r"yield from \1"),
    (r"\bmavcal\.client\.transport\b", "mavcal.client.waiting_transport"),
)
"""What a client that waits says in place of what an asynchronous one does."""


def _waiting(asynchronous: str) -> str:
    """A module of the client that waits for each answer, out of that of the other one."""
    for pattern, instead in WAITING:
        asynchronous = re.sub(pattern, instead, asynchronous)
    return asynchronous


def _waiting_transport() -> str:
    about, _, rest = (ROOT / "client" / "transport.py").read_text(encoding="utf-8").partition("\n\n")
    return _waiting("\n\n".join((about, TRANSPORT_MARK, rest)))


def _client(document: Document) -> str:
    about, base = "waits for nothing", "AsyncTransport"
    body: list[str] = []
    for operation in document.operations:
        body += ["", *_method(operation)]
    used = set(re.findall(r"\b\w+\b", "\n".join(body)))
    imports = []
    kinds = {"AsyncIterable", "AsyncIterator"} & used
    imports.append(f"from collections.abc import {', '.join(sorted(kinds))}")
    if chosen := sorted(used & {"Any", "Literal"}):
        imports.append(f"from typing import {', '.join(chosen)}")
    if "Number" in used:
        imports.append("from mavcal.client.base import Number")
    enums = {"enums": set(document.enums())}
    for module, known in (enums | _modules(document) | {"transport": {base}, "exchange": {"segment"}}).items():
        if not (used | {base}) & known:
            continue
        imports.append(f"from mavcal.client.{module} import {', '.join(sorted((used | {base}) & known))}")
    head = _head(f"The client that {about}: one method for each operation.", *imports)
    return _text([*head, "", "", f"class AsyncClient({base}):", *_docstring(f"Asks a service, and {about}."), *body])


def _method(operation: Operation) -> list[str]:
    places = [_argument(p) for p in operation.parameters if p.place == "path"]
    if operation.raw:
        places.append("content: bytes | AsyncIterable[bytes]")
    named = [p for p in operation.parameters if p.place != "path"]
    named = [*(p for p in named if p.required), *(p for p in named if not p.required)]
    star = ["*"] if named else []
    arguments = ", ".join(["self", *places, *star, *(_argument(p) for p in named)])
    told = _answer_type(operation)
    if operation.stream:
        told = f"AsyncIterator[{told}]"
    lines = [f"    {'def' if operation.stream else 'async def'} {operation.name}({arguments}) -> {told}:"]
    lines += _docstring("\n\n".join(filter(None, (operation.summary, operation.text))), indent=" " * 8)
    path = re.sub(r"\{(\w+)\}", r"{segment(\1)}", operation.path)
    call = [f'{"f" if "{" in path else ""}"{path}"', *_further(operation)]
    if operation.stream:
        call.insert(1, _answer_type(operation))
        return [*lines, f"        return self._follow({', '.join(call)})"]
    call.insert(0, f'"{operation.method}"')
    if operation.answer is None:
        return [*lines, f"        await self._text({', '.join(call)})"]
    if operation.plain:
        return [*lines, f"        return await self._text({', '.join(call)})"]
    call.insert(2, told)
    return [*lines, f"        return await self._ask({', '.join(call)})"]


def _further(operation: Operation) -> Iterable[str]:
    """Arguments of a call besides its address."""
    for place in ("query", "header", "body"):
        chosen = [p for p in operation.parameters if p.place == place and p.wire != "Last-Event-ID"]
        if chosen or (place == "body" and operation.body is not None):
            pairs = ", ".join(f'"{p.wire}": {p.name}' for p in chosen)
            yield f"{place}={{{pairs}}}"
    if operation.raw:
        yield "content=content"
    if operation.resumes:
        yield "last_event_id=last_event_id, resume=True"
    if operation.also:
        yield f"also=({', '.join(str(s) for s in operation.also)},)"


def _argument(parameter: Parameter) -> str:
    kind = _type(parameter.schema)
    if parameter.required:
        return f"{parameter.name}: {kind}"
    return f"{parameter.name}: {kind}{'' if 'None' in kind else ' | None'} = None"


def _answer_type(operation: Operation) -> str:
    if operation.answer is None:
        return "None"
    return "str" if operation.plain else _type(operation.answer)


# --- text


def _head(about: str, *imports: str) -> list[str]:
    return [f'"""{sentence(about)}"""', "", MARK, "", "from __future__ import annotations", "", *imports]


def _docstring(text: str, indent: str = "    ") -> list[str]:
    first, *rest = [sentence(paragraph) for paragraph in text.split("\n\n")]
    quoted = [*textwrap.wrap(f'"""{first}', WIDTH - len(indent))]
    for paragraph in rest:
        quoted += ["", *textwrap.wrap(paragraph, WIDTH - len(indent))]
    if len(quoted) == 1:
        quoted[0] += '"""'
    else:
        quoted.append('"""')
    return [f"{indent}{line}" if line else "" for line in quoted]


def _constant(value: str) -> str:
    name = re.sub(r"\W", "_", value).upper()
    return f"{name}_" if keyword.iskeyword(name) else name


def _text(lines: list[str]) -> str:
    return "\n".join(lines) + "\n"
