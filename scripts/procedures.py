"""``scripts/procedures``: ``docs/procedures.md``, what each procedure needs, ends on, writes and cannot represent."""

from __future__ import annotations

from pathlib import Path

from mavcal.calib.firmware import TITLES
from mavcal.calib.option import Option
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.calib.procedures.spec import ProcedureSpec

PAGE = Path(__file__).resolve().parents[1] / "docs" / "procedures.md"
_HEAD = """# Procedures

For: drone operators, and who writes a prompt of their own.

Written by `scripts/procedures` from the specifications in `calib/procedures`; a test compares them.
Time is the vehicle's own. Every procedure fits every instance that streams, ends when the requested uncertainty is
reached, and gives up with the cause when it cannot be.
"""


def markdown() -> str:
    """The whole document."""
    return "\n".join([_HEAD, _overview(), *(_section(spec) for spec in PROCEDURES.values())])


def _overview() -> str:
    rows = ["| job | needs | ends on | typical length |", "|---|---|---|---|"]
    rows += [f"| `{s.kind}` | {s.needs} | {s.ends_on} | {s.duration_s:.0f} s |" for s in PROCEDURES.values()]
    return "\n".join(rows) + "\n"


def _section(spec: ProcedureSpec) -> str:
    streams = ", ".join(spec.sensors)
    helpful = f"; helpful: {', '.join(spec.helpful)}" if spec.helpful else ""
    lines = [f"## {spec.kind}: {spec.title}", "", f"Streams: {streams}{helpful}.", ""]
    lines += ["| option | default | limits | meaning |", "|---|---|---|---|"]
    lines += [_option(option) for option in spec.options]
    lines += ["", "| | writes | cannot represent |", "|---|---|---|"]
    for key, name in TITLES.items():
        holds = spec.autopilots[key]
        writes, cannot = ("; ".join(items) or "nothing" for items in (holds.writes, holds.cannot_represent))
        lines.append(f"| {name} | {writes} | {cannot} |")
    return "\n".join(lines) + "\n"


def _option(option: Option) -> str:
    unit = f" {option.unit}" if option.unit else ""
    if option.default is None:
        return f"| `{option.name}` | has to be given | {option.low:g} ... {option.high:g}{unit} | {option.help} |"
    if isinstance(option.default, bool):
        return f"| `{option.name}` | {str(option.default).lower()} | | {option.help} |"
    return f"| `{option.name}` | {option.default:g}{unit} | {option.low:g} ... {option.high:g} | {option.help} |"


def main() -> None:
    """Write the page."""
    PAGE.write_text(markdown(), encoding="utf-8")


if __name__ == "__main__":
    main()
