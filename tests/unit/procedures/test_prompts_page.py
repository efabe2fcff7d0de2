"""``docs/prompts.md`` says what the procedures and jobs say."""

from __future__ import annotations

from mavcal.calib.procedures.registry import PROCEDURES
from scripts import prompts


def test_the_page_of_prompts_is_current():
    assert prompts.OUT.read_text(encoding="utf-8") == prompts.page(), "run scripts/prompts"
    assert set(prompts.MODULES) == set(PROCEDURES)


def test_every_prompt_of_a_rest_is_on_the_page():
    page = prompts.page()
    assert "**Put the vehicle on a firm surface and do not touch it.**" in page
    assert "**Restart the vehicle: switch it off and on again." in page


def test_texts_of_a_source_are_found_without_docstrings_options_and_messages():
    source = '"""No text."""\nOption("of its own")\ndef f(x):\n    raise ValueError("a b")\n'
    source += '    return f"{x.n_left} are left"\n'
    assert [(one.line, one.text) for one in prompts.said(source)] == [(5, "‹n left› are left")]
