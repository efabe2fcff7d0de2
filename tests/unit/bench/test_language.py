"""Plain language: the number of long sentences and of riddles goes down, never up; the page of prompts is current."""

from __future__ import annotations

import pytest

from bench import prompts
from bench.language import counts, faults, findings, of_docstring, of_page
from bench.sentences import docstrings, said
from mavcal.calib.procedures.registry import PROCEDURES

CEILING = {
    "page long": 0,
    "page phrase": 2,
    "message long": 0,
    "message phrase": 2,
    "docstring long": 4,
    "docstring phrase": 7,
}
"""What is there today. Lower a number when you have rewritten something; `scripts/language FILE` lists what is left."""


def test_no_more_long_sentences_and_riddles_than_today():
    found = list(findings())
    now = counts(found)
    more = {key: number for key, number in now.items() if number > CEILING[key]}
    assert more == {}, "\n".join(
        f"{f.file}:{f.line}: {f.kind}: {f.text}" for f in found if f"{f.source} {f.kind}" in more
    )


def test_the_page_of_prompts_is_current():
    assert prompts.OUT.read_text(encoding="utf-8") == prompts.page(), "run scripts/prompts"
    assert set(prompts.MODULES) == set(PROCEDURES)


def test_every_prompt_of_a_rest_is_on_the_page():
    page = prompts.page()
    assert "**Put the vehicle on a firm surface and do not touch it.**" in page
    assert "**Restart the vehicle: switch it off and on again." in page


def test_docstrings_are_read_by_paragraph_without_tables_trees_and_examples():
    text = "One line\n    goes on.\n\n    Parameters\n    ----------\n    a\n        What it is.\n\n"
    text += "    ==== ====\n    x y\n\n    >>> f(1)\n    2\n"
    parts = [" ".join(part.split()) for part in of_docstring(text)]
    assert "What it is." in " ".join(parts)
    assert not any("x y" in part or "f(1)" in part for part in parts)


@pytest.mark.parametrize("opening", ["Kinds::", "::", ".. code-block:: text"])
def test_literal_blocks_of_a_docstring_are_left_out_and_end_with_their_indent(opening):
    text = f"Head.\n\n    {opening}\n\n        a b c\n        d e\n\n          deeper\n\n    After that.\n"
    parts = [" ".join(part.split()) for part in of_docstring(text)]
    assert parts == ["Head.", opening, "After that."]


@pytest.mark.parametrize(
    ("text", "kinds"),
    [
        ("Of two units the coarser one.", ["phrase"]),
        ("Of course it stops.", []),
        ("Each is held against its own sensor.", ["phrase"]),
        ("It begins anew.", ["phrase"]),
        (" ".join(["word"] * 26) + ".", ["long"]),
        (" ".join(["word"] * 25) + ".", []),
        (" ".join(["word"] * 20) + "; " + " ".join(["word"] * 20) + ".", []),
        ("`a b c d e f g h i j k l m n o p q r s t u v w x y z a b c`.", []),
    ],
)
def test_faults_are_seen(text, kinds):
    assert [kind for kind, _ in faults(text)] == kinds


def test_pages_are_read_by_paragraph_item_and_cell_without_code():
    page = "# Title\n\nOne line\ngoes on.\n- an item\n- another\n\n| a | b |\n|---|---|\n"
    page += "\n    code here\n\n```\nmore\n```\n"
    texts = [text for _, text in of_page(page)]
    assert texts[:4] == ["Title", "One line goes on.", "an item", "another"]
    assert not any("code" in text or "more" in text for text in texts)


def test_messages_are_told_from_docstrings_and_options():
    source = (
        '"""Module text."""\n'
        'OPTION = Option("a", int, 1, "help of it")\n'
        'def f(x):\n    """Own text."""\n    if x:\n        raise E(f"a reason: {x.y_z:.1f} s")\n'
        '    return f"go on {len(x)} times"\n'
    )
    assert [one.text for one in said(source)] == ["a reason: ‹y z› s", "go on ‹x› times"]
    assert [one.text for one in said(source, raised=False)] == ["go on ‹x› times"]
    assert [one.text for one in docstrings(source)] == ["Module text.", "Own text."]
