"""``scripts/effects``: the catalogue's table in ``docs/gap-effects.md``, read from the code."""

from __future__ import annotations

from pathlib import Path

from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, LatticeEffect, MeanEffect

PAGE = Path(__file__).resolve().parents[1] / "docs" / "gap-effects.md"
BEGIN = "## The catalogue\n"
HEADER = "| effect | parameters | excited by | rivals | told apart by |\n|---|---|---|---|---|\n"
FORMS = {
    "~wave": "as a wave",
    "~late": "with a lag",
    "~slow": "that takes its time",
    "~throttle": "by the throttle",
}
"""How a second description of an effect is called."""


def table() -> str:
    """Every effect of the catalogue, one line each."""
    return HEADER + "".join(f"{row(effect)}\n" for effect in catalogue())


def row(effect: CatalogueEffect) -> str:
    """The line of one effect."""
    stems: dict[tuple[str, str], list[str]] = {}
    for parameter in estimated(effect):
        stem, _, suffix = parameter.name.partition(".")
        stems.setdefault((stem, parameter.unit), []).append(suffix)
    cells = [f"`{stem}{'.{' + ','.join(s) + '}' if s != [''] else ''}` {unit}" for (stem, unit), s in stems.items()]
    return f"| {_name(effect)} | {', '.join(cells)} | {effect.excited_by} | {', '.join(effect.rivals)} | {effect.fix} |"


def estimated(effect: CatalogueEffect) -> list[EffectParameter]:
    """What is estimated of it: its amplitudes, then its shape."""
    return [*effect.parameters, *([effect.shape.parameter] if effect.shape is not None else [])]


def _name(effect: CatalogueEffect) -> str:
    if effect.form:
        return f"`{effect.id}` {FORMS[effect.form]}"
    in_samples_too = isinstance(by_id()[effect.id], LatticeEffect) and isinstance(effect, MeanEffect)
    return f"`{effect.id}`" + (" before the noise" if in_samples_too else "")


def with_table(page: str) -> str:
    """The page with the table as the code has it."""
    before, _, rest = page.partition(BEGIN)
    after = rest[rest.index("\n## ") :]
    return f"{before}{BEGIN}\nWritten by `scripts/effects` from the code.\n\n{table()}{after}"


def main() -> None:
    """Write the table."""
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
