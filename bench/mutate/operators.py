"""What is changed in a module: one operator, constant, condition or statement at a time, by its syntax tree."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass

from bench.mutate.reach import places

COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
CALCULATED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
}
_SAYS_ONLY = ("log", "logger")
"""Names whose calls change nothing but what the operator of the service reads."""


@dataclass(frozen=True)
class Mutant:
    """One change: the number of the syntax node in the order of a walk, and what is done to it.

    A test that runs none of the lines from `first` to `last` cannot notice. `inside`: it is in the body of a function.
    """

    path: str
    node: int
    choice: int
    line: int
    text: str
    first: int
    last: int
    inside: bool


def mutants(source: str, path: str) -> list[Mutant]:
    """Every change that is made to a module, in the order of its lines."""
    tree = ast.parse(source)
    lines = source.splitlines()
    found = []
    place = places(tree)
    for number, node in _mutable(tree):
        line = getattr(node, "lineno", 1)
        there = place[id(node)]
        for choice, (what, _) in enumerate(_changes(node)):
            text = f"{what}: {lines[line - 1].strip()}"
            found.append(
                Mutant(path, number, choice, line, text, there.lines.start, there.lines.stop - 1, there.inside)
            )
    return sorted(found, key=lambda m: (m.line, m.node, m.choice))


def mutated(source: str, mutant: Mutant) -> ast.Module:
    """The module with that change, every other thing at its line."""
    tree = ast.parse(source)
    target = next(node for number, node in _mutable(tree) if number == mutant.node)
    _, changed = _changes(target)[mutant.choice]
    whole: ast.Module = ast.fix_missing_locations(_Replace(target, changed).visit(tree))
    return whole


def _mutable(tree: ast.Module) -> Iterator[tuple[int, ast.AST]]:
    """Nodes with their numbers; without annotations, docstrings, defaults of decorators, logging."""
    skipped: set[int] = set()
    for node in ast.walk(tree):
        for part in _untouched(node):
            skipped.update(id(inner) for inner in ast.walk(part))
    for number, node in enumerate(ast.walk(tree)):
        if id(node) not in skipped:
            yield number, node


def _untouched(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.AnnAssign | ast.arg) and node.annotation is not None:
        yield node.annotation
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        yield from node.decorator_list
        if node.returns is not None:
            yield node.returns
    if isinstance(node, ast.ClassDef):
        yield from node.decorator_list
        yield from node.bases
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        yield node
    if isinstance(node, ast.Import | ast.ImportFrom | ast.JoinedStr | ast.Assert):
        yield node  # messages are wording; asserts are for the type checker
    if _is_logging(node.value if isinstance(node, ast.Expr) else node):
        yield node
    if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        yield node


def _changes(node: ast.AST) -> list[tuple[str, ast.AST]]:
    """What a node can be replaced by, in words and as a node."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        other = copy.deepcopy(node)
        other.ops[0] = COMPARED[type(node.ops[0])]()
        return [(f"{type(node.ops[0]).__name__} to {type(other.ops[0]).__name__}", other)]
    if isinstance(node, ast.BinOp) and type(node.op) in CALCULATED and not _is_text(node):
        other = copy.deepcopy(node)
        other.op = CALCULATED[type(node.op)]()
        return [(f"{type(node.op).__name__} to {type(other.op).__name__}", other)]
    if isinstance(node, ast.BoolOp):
        other = copy.deepcopy(node)
        other.op = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        return [("and to or" if isinstance(node.op, ast.And) else "or to and", other)]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return [("without not", node.operand)]
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return [("without minus", node.operand)]
    if isinstance(node, ast.Constant):
        return _other_constants(node)
    if isinstance(node, ast.If):
        return [(f"if {truth}", _with_test(node, truth=truth)) for truth in (True, False)]
    if isinstance(node, ast.Return) and node.value is not None and not _is_nothing(node.value):
        return [("return None", ast.Return(ast.Constant(None)))]
    if isinstance(node, ast.Raise) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call | ast.Await)):
        return [("left out", ast.Pass())]
    if isinstance(node, ast.Break):
        return [("break to continue", ast.Continue())]
    if isinstance(node, ast.Continue):
        return [("continue to break", ast.Break())]
    return []


def _other_constants(node: ast.Constant) -> list[tuple[str, ast.AST]]:
    if isinstance(node.value, bool):
        return [(f"{node.value} to {not node.value}", ast.Constant(not node.value))]
    if isinstance(node.value, int | float):
        return [(f"{node.value} to {node.value + 1}", ast.Constant(node.value + 1))]
    return []


def _with_test(node: ast.If, *, truth: bool) -> ast.If:
    other = copy.deepcopy(node)
    other.test = ast.Constant(truth)
    return other


def _is_logging(node: ast.AST) -> bool:
    called = node.func if isinstance(node, ast.Call) else None
    owner = called.value if isinstance(called, ast.Attribute) else None
    return isinstance(owner, ast.Name) and owner.id in _SAYS_ONLY


def _is_nothing(node: ast.AST) -> bool:
    """None, or False, which is as good to whoever asks for a truth."""
    return isinstance(node, ast.Constant) and (node.value is None or node.value is False)


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr) or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


class _Replace(ast.NodeTransformer):
    def __init__(self, target: ast.AST, by: ast.AST) -> None:
        self._target, self._by = target, by

    def visit(self, node: ast.AST) -> ast.AST:
        if node is self._target:
            return ast.copy_location(self._by, node)
        return self.generic_visit(node)
