"""The documentation: links lead somewhere, pages say for whom they are and stand in the index, and they are few."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BENCH = ROOT / "bench" / "README.md"
OURS = sorted(DOCS.rglob("*.md"))
PAGES = [*sorted(ROOT.glob("*.md")), *OURS, BENCH, ROOT / "bench" / "seals" / "README.md"]
MOST_PAGES = 40
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
NAMED = re.compile(r"`((?:docs|bench)/[\w./-]+\.(?:md|json|png|svg))`")


def links(text: str) -> list[str]:
    """Targets inside the repository; addresses of the web are left out."""
    return [t for t in LINK.findall(CODE.sub("", text)) if not re.match(r"[a-z]+:", t)]


def anchors(page: Path) -> set[str]:
    """Names of the headings, as a page of the web has them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", h.lower()).strip().replace(" ", "-") for h in headings}


def broken(page: Path, text: str) -> list[str]:
    """Links of a page whose file, or whose heading, is not there."""
    found = []
    for target in links(text):
        path, _, heading = target.partition("#")
        file = page if not path else (page.parent / path).resolve()
        if not file.exists() or (heading and file.suffix == ".md" and heading not in anchors(file)):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_resolves(page):
    text = page.read_text(encoding="utf-8")
    assert broken(page, text) == []
    assert [name for name in NAMED.findall(text) if not (ROOT / name).exists()] == []


def test_pages_are_few_say_for_whom_they_are_and_stand_in_the_index():
    front = DOCS / "README.md"
    told = {(DOCS / target.partition("#")[0]).resolve() for target in links(front.read_text(encoding="utf-8"))}
    assert sorted(str(page) for page in {*OURS} - told - {front}) == []
    assert [p.name for p in OURS if not re.match(r"# .+\n\nFor: \w.+", p.read_text(encoding="utf-8"))] == []
    assert len(OURS) <= MOST_PAGES


def test_every_picture_is_shown():
    shown = {(p.parent / t).resolve() for p in PAGES for t in links(p.read_text(encoding="utf-8"))}
    assert sorted(p.name for p in (DOCS / "pictures").iterdir() if p not in shown) == []


def test_a_broken_link_is_seen(tmp_path):
    page = tmp_path / "a.md"
    page.write_text("# One two\n", encoding="utf-8")
    text = "[a](a.md#one-two) [b](b.md) [c](#three) [d](https://example.org) `[e](e.md)`"
    assert broken(page, text) == ["b.md", "#three"]
