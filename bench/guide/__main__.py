"""``python -m bench.guide [--page]``: write ``docs/methods.md`` and its pictures; ``--page``: leave the pictures."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from bench.guide.page import markdown
from bench.guide.pictures import PICTURES

DOCS = Path(__file__).resolve().parents[2] / "docs"


def main(argv: Sequence[str]) -> int:
    """Write everything, or the page alone."""
    (DOCS / "methods.md").write_text(markdown(), encoding="utf-8")
    if "--page" not in argv:
        (DOCS / "pictures").mkdir(exist_ok=True)
        for name, draw in PICTURES.items():
            (DOCS / "pictures" / f"{name}.svg").write_text(draw(), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
