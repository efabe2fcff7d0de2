"""``python -m service.gap_process``: one gap diagnosis in a process of its own, which can be ended at any time.

An order as JSON on stdin, ``{"real": {"path", "reading", "sha256"}, "sim": {...} | null, "nominal": [{...}], "title",
"out"}``; the report's JSON and page are written beside `out`. Exit code 0; 1 with the reason as JSON on stdout.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def diagnosed(order: Mapping[str, Any]) -> None:
    """Read, diagnose, write ``out.json`` and ``out.html``.

    Raises
    ------
    CalibError
        If a recording cannot be read with its options, or they have nothing in common.
    """
    from calib import gap, logs
    from calib.gap.schema import as_json
    from calib.gap_report import gap_to_html

    def read(part: Mapping[str, Any]) -> Any:
        return logs.read(Path(part["path"]), **part["reading"])

    real = read(order["real"])
    sim = None if order["sim"] is None else read(order["sim"])
    nominal = tuple(read(part) for part in order["nominal"])
    hashes = {role: order[role]["sha256"] for role in ("real", "sim") if order[role] is not None}
    report = gap.run(real, sim, nominal, inputs=hashes)
    out = Path(order["out"])
    out.with_suffix(".html").write_text(gap_to_html(report, title=order["title"]), encoding="utf-8")
    out.with_suffix(".report").write_text(json.dumps(as_json(report), allow_nan=False), encoding="utf-8")


def main() -> int:
    """Do what stdin orders."""
    from calib.errors import CalibError

    try:
        diagnosed(json.load(sys.stdin))
    except CalibError as error:
        sys.stdout.write(json.dumps({"error": str(error)}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
