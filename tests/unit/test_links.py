"""Every link of the documentation leads to a file that is there, and every page can be reached from the front page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
NAMED = re.compile(r"`((?:docs/)[\w./-]+\.(?:md|json|png|svg))`")
MOST_BYTES = 150_000


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


def test_every_page_is_linked_from_the_front_page():
    front = ROOT / "docs" / "README.md"
    told = {(front.parent / target.partition("#")[0]).resolve() for target in links(front.read_text(encoding="utf-8"))}
    pages = {*(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "decisions").glob("*.md")} - {front}
    assert sorted(p.name for p in pages - told) == []


def test_pictures_of_the_first_pages_are_small():
    shown = set()
    for name in ("first-calibration.md", "first-diagnosis.md", "library.md"):
        shown |= set(links((ROOT / "docs" / name).read_text(encoding="utf-8")))
    pictures = [ROOT / "docs" / target for target in shown if target.endswith(".png")]
    assert len(pictures) > 8
    assert {p.name: p.stat().st_size for p in pictures if p.stat().st_size > MOST_BYTES} == {}


def test_a_broken_link_is_seen(tmp_path):
    page = tmp_path / "a.md"
    page.write_text("# One two\n", encoding="utf-8")
    text = "[a](a.md#one-two) [b](b.md) [c](#three) [d](https://example.org) `[e](e.md)`"
    assert broken(page, text) == ["b.md", "#three"]
