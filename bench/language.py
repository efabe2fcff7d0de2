"""``scripts/language``: sentences that are too long, and phrases that plain English does not have.

Looks at the pages of ``docs``, at README, CONTRIBUTING and CHANGELOG, at all docstrings, and at the messages of
``calib`` and ``service``. ``docs/history`` is left alone: it quotes what was. With the name of a file it lists that
file alone.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from bench.sentences import docstrings, said

ROOT = Path(__file__).resolve().parents[1]
MOST_WORDS = 25
FORBIDDEN = (
    re.compile(r"^Of (?!course)"),
    re.compile(r"\bof which\b"),
    re.compile(r"\banew\b"),
    re.compile(r"\bat last\b"),
    re.compile(r"\bheld against\b"),
    re.compile(r"\bfrom (?:\w+ )?(?:once|twice) (?:\w+ )?on\b"),
    re.compile(r"\bwhat is told\b"),
)
"""Ways of speaking that a reader has to translate."""
_CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
_END = re.compile(r"(?<=[.?!:;])\s+(?=[A-Z‹*\"`(\[])|(?<=[;:])\s+|\n\s*\n")
_WORD = re.compile(r"[A-Za-z‹][\w'’›-]*")
_DATA = re.compile(r"\||\b(?:INSERT|DELETE|SELECT) |^[0-9a-f]{2} [A-Z]")
"""Texts that no person reads as sentences: tables, statements of a database."""
_LITERAL = re.compile(r"::$|\.\. code-block:: \w+$")
"""Introduces a block of code, formulas or columns."""
_DRAWN = re.compile(r"={4}|\+--|[│├└─]|^\s*>>>|^\s*\* ", re.MULTILINE)
_SPEAKING = ("calib", "service")
"""Packages whose texts a user reads."""
_PACKAGES = (*_SPEAKING, "client", "bench", "tests")
_PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs")


@dataclass(frozen=True)
class Finding:
    """A sentence, where it stands, and what is wrong with it."""

    file: str
    line: int
    kind: str
    """``long`` or ``phrase``."""
    source: str
    """``page``, ``message`` or ``docstring``."""
    text: str


def faults(text: str) -> Iterator[tuple[str, str]]:
    """Kind and sentence of each fault."""
    for sentence in sentences(text):
        if len(_WORD.findall(sentence)) > MOST_WORDS:
            yield "long", sentence
        if any(phrase.search(sentence) for phrase in FORBIDDEN):
            yield "phrase", sentence


def sentences(text: str) -> list[str]:
    """Sentences of prose; a colon and a semicolon end one too, code counts as one word.

    >>> sentences("It stops: nothing moves. See `a.b c`; then go on.")
    ['It stops:', 'nothing moves.', 'See X;', 'then go on.']
    """
    plain = _CODE.sub("X", text)
    return [" ".join(part.split()) for part in _END.split(plain) if part.strip()]


def of_page(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs, items of lists and cells of a page with their lines; code blocks are left out."""
    fenced, start, lines = False, 1, list[str]()
    for number, line in enumerate([*text.splitlines(), ""], start=1):
        fenced ^= line.startswith("```")
        ends = not line.strip() or line.startswith(("#", "|", "- ", "    ", "```", "!")) or fenced
        if ends and lines:
            yield start, " ".join(lines)
            lines = []
        if fenced or line.startswith(("    ", "```", "!")):
            continue
        if line.startswith("|"):
            yield from ((number, cell) for cell in line.strip("|").split("|"))
        elif line.strip():
            start = start if lines else number
            lines.append(line.lstrip("#-0123456789. "))


def of_docstring(text: str) -> Iterator[str]:
    """Paragraphs of a docstring, broken where the indent changes.

    Tables, trees, examples and literal blocks (indented below a ``::``) are left out.
    """
    lines, indent, literal = list[str](), -1, -1
    for line in [*text.splitlines(), ""]:
        depth = len(line) - len(line.lstrip())
        if lines and (not line.strip() or (depth != indent and len(lines) > 1) or line.strip().startswith("---")):
            block = "\n".join(lines)
            literal = literal if indent > literal else -1
            if literal < 0 and not _DRAWN.search(block):
                yield block
            if literal < 0 and _LITERAL.search(block):
                literal = indent
            lines = []
        if line.strip() and not line.strip().startswith("---"):
            lines.append(line)
            indent = depth


def findings(root: Path = ROOT) -> Iterator[Finding]:
    """Everything that is found, page by page and module by module."""
    for path in _pages(root):
        if "history" in path.parts:
            continue
        name = str(path.relative_to(root))
        for line, text in of_page(path.read_text(encoding="utf-8")):
            yield from (Finding(name, line, kind, "page", sentence) for kind, sentence in faults(text))
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            name, source = str(path.relative_to(root)), path.read_text(encoding="utf-8")
            messages = said(source) if package in _SPEAKING else ()
            for origin, texts in (("message", messages), ("docstring", docstrings(source))):
                for one in texts:
                    if origin == "message" and _DATA.search(one.text):
                        continue
                    parts = of_docstring(one.text) if origin == "docstring" else (one.text,)
                    yield from (Finding(name, one.line, k, origin, s) for part in parts for k, s in faults(part))


def _pages(root: Path) -> Iterator[Path]:
    for name in _PAGES:
        path = root / name
        yield from [path] if path.is_file() else sorted(path.rglob("*.md"))


def counts(found: list[Finding]) -> dict[str, int]:
    """Number of findings by source and kind: ``page long``."""
    keys = [f"{source} {kind}" for source in ("page", "message", "docstring") for kind in ("long", "phrase")]
    return {key: sum(f"{f.source} {f.kind}" == key for f in found) for key in keys}


def main() -> None:
    """List the findings of the files named, or count those of all."""
    found = list(findings())
    for one in found:
        if any(name in one.file for name in sys.argv[1:]):
            print(f"{one.file}:{one.line}: {one.kind}: {one.text}")
    for key, number in counts(found).items():
        print(f"{key}: {number}")


if __name__ == "__main__":
    main()
