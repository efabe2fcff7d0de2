"""``scripts/prompts``: ``docs/prompts.md``, everything that the procedures and jobs say, read from their code."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from mavcal.calib.procedures.registry import PROCEDURES

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "prompts.md"
HEAD = """# Every prompt of every procedure

For: drone operators, and developers who show or translate prompts.

Written by `scripts/prompts` from the code; a test says whether it is current. What stands in ‹ › is filled in while the
job runs. A **prompt** says what to do now. A **message** is a part of a sentence: it tells progress, why a capture
ended, what to do next, or what was left out. Prompts come from a live job as they come from a replayed log.
"""
MODULES = {
    "gyro": "gyro", "accel": "accel", "mag": "mag", "thermal": "thermal", "level": "level",
    "accel-one-axis": "one_axis", "accel-six-face": "six_face", "mag-rings": "rings",
    "mag-fixed-yaw": "fixed_yaw",
    "gyro-turntable": "turntable", "gyro-thread": "thread", "imu-multi": "imu",
}  # fmt: skip
"""The module of each kind of job."""
SHARED = {
    "All procedures": ("base", "intake", "motion", "roster", "protocol"),
    "Poses": ("poses", "pose_fit"),
    "Compasses": ("mag_track",),
}
JOBS = {
    "While a plan is written and proved": (
        "write/stream_check",
        "calibrate/watch",
        "write/transaction",
        "core/admission",
        "write/steps",
    ),
}
SERVICE = ROOT / "service" / "jobs"
CALIB = ROOT / "calib" / "procedures"


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for kind, spec in PROCEDURES.items():
        parts.append(_section(f"{kind}: {spec.title}", [CALIB / f"{MODULES[kind]}.py"]))
    parts += [_section(title, [CALIB / f"{name}.py" for name in names]) for title, names in SHARED.items()]
    parts += [_section(title, [SERVICE / f"{name}.py" for name in names]) for title, names in JOBS.items()]
    return "\n".join(parts)


def _section(title: str, files: list[Path]) -> str:
    texts = [one for file in files for one in said(file.read_text(encoding="utf-8"))]
    prompts = dict.fromkeys(_clean(one) for one in texts if is_prompt(one))
    messages = dict.fromkeys(_clean(one) for one in texts if not is_prompt(one))
    lines = [f"## {title}", ""]
    lines += [f"- **{text}**" for text in prompts]
    lines += [""] if prompts else []
    lines += [f"- {text}" for text in messages]
    return "\n".join([*lines, ""])


def is_prompt(one: Said) -> bool:
    """Whether it is a sentence that stands alone."""
    text = one.text.strip().removeprefix("‹note›")
    return text[:1].isupper() and text.endswith((".", "?"))


def _clean(one: Said) -> str:
    return " ".join(one.text.split()).removeprefix("‹note›").strip(" ;,")


# --- texts of the code that a person reads

SPECIFIED = frozenset({"Option", "ProcedureSpec"})
"""What these say stands in pages of its own."""


@dataclass(frozen=True)
class Said:
    """A text with its line; what is filled in when the program runs stands in ``‹›``."""

    line: int
    text: str


def said(source: str) -> Iterator[Said]:
    """Texts of two words and more in the order of their lines, without messages of exceptions."""
    tree = ast.parse(source)
    left_out = _left_out(tree)
    found = [
        Said(node.lineno, text)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in left_out and (text := _text(node))
    ]
    yield from sorted((one for one in found if " " in one.text.strip()), key=lambda one: one.line)


def _left_out(tree: ast.AST) -> set[int]:
    found: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            found.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            found |= {id(part) for value in node.values for part in ast.walk(value)}
        elif _is_specification(node) or isinstance(node, ast.Raise):
            found |= {id(part) for part in ast.walk(node)}
    return found


def _is_specification(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in SPECIFIED


def _text(node: ast.Constant | ast.JoinedStr) -> str:
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    parts = [str(v.value) if isinstance(v, ast.Constant) else f"‹{_place(v)}›" for v in node.values]
    return "".join(parts)


def _place(value: ast.AST) -> str:
    """What is filled in, in a word or two: the name in the expression that says most."""
    match value:
        case ast.FormattedValue(value=inner) | ast.IfExp(body=inner) | ast.GeneratorExp(elt=inner):
            return _place(inner)
        case ast.Call(args=[first, *_]) | ast.BoolOp(values=[first, *_]):
            return _place(first)
        case ast.Call(func=ast.Attribute(value=inner)) | ast.UnaryOp(operand=inner):
            return _place(inner)
        case ast.BinOp(left=ast.Constant(), right=inner) | ast.BinOp(left=inner):
            return _place(inner)
        case ast.Subscript(slice=ast.Constant(value=str(key))):
            return _words(key)
        case ast.Subscript(value=inner) | ast.Starred(value=inner):
            return _place(inner)
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return _words(name)
        case _:
            return "…"


def _words(name: str) -> str:
    plain = name.strip("_").replace("_", " ").lower()
    return {"texts": "pose", "names": "sensor"}.get(plain, plain)


def main() -> None:
    """Write the page."""
    OUT.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
