"""Texts of the code that a person reads, out of the syntax tree: no docstring, no option, no name of a field."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

SPECIFIED = frozenset({"Option", "ProcedureSpec"})
"""What these say stands in pages of its own."""


@dataclass(frozen=True)
class Said:
    """A text with its line; what is filled in when the program runs stands in ``‹›``."""

    line: int
    text: str


def said(source: str, *, raised: bool = True) -> Iterator[Said]:
    """Texts of two words and more in the order of their lines; `raised`: messages of exceptions too."""
    tree = ast.parse(source)
    left_out = _left_out(tree, raised=raised)
    found = [
        Said(node.lineno, text)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in left_out and (text := _text(node))
    ]
    yield from sorted((one for one in found if " " in one.text.strip()), key=lambda one: one.line)


def docstrings(source: str) -> Iterator[Said]:
    """Docstrings of modules, classes and functions, and the texts that stand below a constant or a field."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield Said(node.lineno, node.value.value)


def _left_out(tree: ast.AST, *, raised: bool) -> set[int]:
    found: set[int] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            found.add(id(node.value))
        elif isinstance(node, ast.JoinedStr):
            found |= {id(part) for value in node.values for part in ast.walk(value)}
        elif _is_specification(node) or (isinstance(node, ast.Raise) and not raised):
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
