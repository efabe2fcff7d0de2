"""``scripts/prompts``: ``docs/prompts.md``, everything that the procedures and jobs say, read from their code."""

from __future__ import annotations

from pathlib import Path

from bench.sentences import Said, said
from mavcal.calib.procedures.registry import PROCEDURES

ROOT = Path(__file__).resolve().parents[1]
OUT = ROOT / "docs" / "prompts.md"
HEAD = """# Every prompt of every procedure

Written by `scripts/prompts` from the code; a test says whether it is current. What stands in ‹ › is filled in while the
job runs. A **prompt** says what to do now. A **message** is a part of a sentence: it tells progress, why a capture
ended, what to do next, or what was left out. Prompts come from a live job as they come from a replayed log.
"""
MODULES = {
    "gyro": "gyro", "accel": "accel", "mag": "mag", "thermal": "thermal", "level": "level",
    "accel-one-axis": "one_axis", "accel-six-face": "six_face", "mag-rings": "rings",
    "mag-fixed-yaw": "fixed_yaw",
    "gyro-turntable": "turntable", "gyro-thread": "thread", "imu-multi": "imu",
}  # fmt: skip
"""The module of each kind of job."""
SHARED = {
    "All procedures": ("ticked", "intake", "motion", "roster", "placing", "results", "protocol"),
    "Poses": ("poses", "pose_fit"),
    "Compasses": ("mag_track", "ring_track"),
}
JOBS = {
    "While a plan is written and proved": ("verify", "watch", "transaction", "patience", "restart"),
}
SERVICE = ROOT / "service" / "jobs"
CALIB = ROOT / "calib" / "procedures"


def page() -> str:
    """The whole page."""
    parts = [HEAD]
    for kind, spec in PROCEDURES.items():
        parts.append(_section(f"{kind}: {spec.title}", [CALIB / f"{MODULES[kind]}.py"]))
    parts += [_section(title, [CALIB / f"{name}.py" for name in names]) for title, names in SHARED.items()]
    parts += [_section(title, [SERVICE / f"{name}.py" for name in names]) for title, names in JOBS.items()]
    return "\n".join(parts)


def _section(title: str, files: list[Path]) -> str:
    texts = [one for file in files for one in said(file.read_text(encoding="utf-8"), raised=False)]
    prompts = dict.fromkeys(_clean(one) for one in texts if is_prompt(one))
    messages = dict.fromkeys(_clean(one) for one in texts if not is_prompt(one))
    lines = [f"## {title}", ""]
    lines += [f"- **{text}**" for text in prompts]
    lines += [""] if prompts else []
    lines += [f"- {text}" for text in messages]
    return "\n".join([*lines, ""])


def is_prompt(one: Said) -> bool:
    """Whether it is a sentence that stands alone."""
    text = one.text.strip().removeprefix("‹note›")
    return text[:1].isupper() and text.endswith((".", "?"))


def _clean(one: Said) -> str:
    return " ".join(one.text.split()).removeprefix("‹note›").strip(" ;,")


def main() -> None:
    """Write the page."""
    OUT.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
