"""Pages from templates: escaped, complete, and never put together from strings."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from mavcal.calib import pages

ROOT = Path(__file__).resolve().parents[2]
EVIL = '<script>alert("x")</script>'
SDF = ROOT / "calib" / "gap" / "export" / "gazebo.py"
"""Elements of numbers for a simulator, which no browser reads."""
ELEMENT = re.compile(r"</?[a-z][a-z0-9]*(\s[^<>]*)?/?>")


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], str]:
    """Makes a package of one template, ``a.html``, and tells its name: one of its own for each test."""
    name = f"made_for_{tmp_path.name}"

    def made(text: str) -> str:
        folder = tmp_path / name / "templates"
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()
        (folder / "a.html").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        return name

    return made


def test_values_are_escaped_and_pictures_are_not(package: Callable[[str], str]) -> None:
    made = package("<p title='{{ name }}'>{{ name }}</p>{{ picture }}")
    said = pages.page(made, "a.html", name=EVIL + "'", picture=Markup("<svg/>"))
    assert "<script" not in said
    assert said.count("&lt;script&gt;") == 2
    assert "&#39;" in said
    assert said.endswith("<svg/>")


def test_a_name_that_nobody_gave_is_an_error(package: Callable[[str], str]) -> None:
    made = package("{{ nobody }}")
    with pytest.raises(UndefinedError, match="nobody"):
        pages.page(made, "a.html")


def constant_alone(call: ast.Call) -> bool:
    return all(isinstance(argument, ast.Constant) for argument in call.args)


def pasted(source: str) -> Iterator[str]:
    """Where a source puts values into markup by itself, or calls something safe that it did not write."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            constant = "".join(v.value if isinstance(v, ast.Constant) else "0" for v in node.values)
            if ELEMENT.search(constant):
                yield f"line {node.lineno}: {constant}"
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "Markup" and not constant_alone(node):
            yield f"line {node.lineno}: {ast.unparse(node)}"


@pytest.mark.parametrize("folder", ["calib", "service"])
def test_no_markup_is_put_together_from_strings(folder: str) -> None:
    found = {
        str(path.relative_to(ROOT)): bad
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path != SDF and (bad := list(pasted(path.read_text(encoding="utf-8"))))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("f'<p>{name}</p>'", 1),
        ("f'<circle cx=\"{x}\"/>'", 1),
        ("Markup(name)", 1),
        ("Markup('<p>{}</p>').format(name)", 0),
        ("f'{low} < {high}'", 0),
    ],
)
def test_the_rule_sees_a_violation(source: str, count: int) -> None:
    assert len(list(pasted(source))) == count
