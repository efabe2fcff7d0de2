"""``python -m bench.realdata``: fit every real recording, write ``docs/real-data.md``, exit 1 if an answer differs."""

from __future__ import annotations

import sys
from pathlib import Path

from bench.realdata import inertial, magnetic, thermal
from bench.realdata.finding import Finding, table
from bench.realdata.page import page
from bench.realdata.recordings import DATA

PAGE = Path(__file__).resolve().parents[2] / "docs" / "real-data.md"


def findings() -> list[Finding]:
    """Every recording's."""
    return [*inertial.findings(), *magnetic.findings(), *thermal.findings()]


def main() -> int:
    """Exit code 2: the recordings are not here."""
    if not DATA.is_dir():
        print(f"the recordings are not here: {DATA}", file=sys.stderr)
        return 2
    found = findings()
    PAGE.write_text(page(found), encoding="utf-8")
    print(table(found))
    return int(any(f.agrees is False for f in found))


if __name__ == "__main__":
    sys.exit(main())
