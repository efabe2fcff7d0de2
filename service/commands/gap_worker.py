"""``python -m mavcal.service.commands.gap_worker``: diagnoses pairs of files named on stdin, a JSON object a line.

The other side of the withheld-effect check: a process of its own that sees files with random names and nothing else.
``{"real": path, "sim": path or null, "nominal": [...], "without": [...], "nested": bool}`` gives
``{"report": {...}, "seconds": s}`` or ``{"error": text, "seconds": s}``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def diagnosed(order: Mapping[str, Any]) -> dict[str, Any]:
    """The answer to one order; whatever goes wrong in the diagnosis is an answer too, and counts as a failure."""
    from mavcal.calib import gap, logs
    from mavcal.calib.gap.schema import as_json

    real = logs.read(Path(order["real"]))
    sim = None if order.get("sim") is None else logs.read(Path(order["sim"]))
    nominal = [logs.read(Path(path)) for path in order.get("nominal") or []]
    start = time.perf_counter()
    try:
        report = gap.run(real, sim, nominal, without=tuple(order["without"]), nested=bool(order["nested"]))
    except Exception as error:  # noqa: BLE001 - a crash of what is judged is a result
        return {"error": f"{type(error).__name__}: {error}", "seconds": time.perf_counter() - start}
    return {"report": as_json(report), "seconds": time.perf_counter() - start}


def main() -> None:
    """Answer until stdin ends."""
    from mavcal.calib.report import plain

    for line in sys.stdin:
        answer = diagnosed(json.loads(line))
        sys.stdout.write(json.dumps(plain(answer), allow_nan=False) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
