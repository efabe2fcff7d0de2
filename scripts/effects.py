"""``scripts/effects``: the tables of ``docs/gap-effects.md``, read from the code."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from mavcal.calib.airframe import effects as airframe
from mavcal.calib.airframe import ground
from mavcal.calib.airframe.density import Densities, Density
from mavcal.calib.airframe.effects import Act, AirframeEffect
from mavcal.calib.airframe.physics import FORCE_ONLY, TORQUE_ONLY, Kind, Layout
from mavcal.calib.airframe.words import FIXES
from mavcal.calib.gap.effects import by_id, catalogue
from mavcal.calib.gap.effects.base import CatalogueEffect, EffectParameter, LatticeEffect, MeanEffect
from mavcal.calib.gap_report.airframe_effects import labels, plain_name
from mavcal.calib.recording import Sensor
from tests.unit.gap.effects.imitation import LEAST, MISSIONS, NONE, NOT_TESTABLE, closest

PAGE = Path(__file__).resolve().parents[1] / "docs" / "gap-effects.md"
SENSORS = "## The catalogue\n"
MODEL = "### Parameters of the model\n"
AIRFRAME = "### Effects of airframe and air\n"
IMITATORS = "| sensor | effect | at rest | hover | tumble |\n|---|---|---|---|---|\n"
WRITTEN = "Written by `scripts/effects` from the code."
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


AIRFRAME_HEADER = (
    "| effect | what it does to the model | its parameters | seen in | what shows it, and decides |\n"
    "|---|---|---|---|---|\n"
)
_ACTS = {Act.TIMES: "× (1 + value)", Act.OVER: "/ (1 + value)", Act.PLUS: "+ value"}
_A_MOTOR = 1
"""Effects of single motors are alike: the first one's stand for all."""


def model_table() -> str:
    """The parameters of the model, as the table in the docstring of its layout describes them."""
    _, described, _ = re.split(r"^ *=+ +=+$", Layout.__doc__ or "", flags=re.MULTILINE)
    rows = (re.split(r"\s{2,}", line.strip(), maxsplit=1) for line in described.strip().splitlines())
    cells = (f"| {', '.join(map(_coded, names.split(', ')))} | {what} |\n" for names, what in rows)
    return "| parameter | what it is |\n|---|---|\n" + "".join(cells)


def _coded(name: str) -> str:
    """``gain_x y z`` as one name for three axes, ``weak_1 ...`` as the first of many."""
    first, *others = name.split()
    if others == ["..."]:
        return f"`{first}` …"
    stem, _, end = first.rpartition("_")
    return f"`{stem}_{{{','.join([end, *others])}}}`" if others else f"`{first}`"


def airframe_table() -> str:
    """Every effect of airframe and air that a contest of two flights has, one line each."""
    forms: dict[str, list[AirframeEffect]] = {}
    known = Density(1.1, 0.01)
    expected = airframe.of_density(Densities(known, known), rotors_damp=True)
    for effect in (*airframe.catalogue(Layout(4), Kind(), (1.0, 1.0, 1.0)), expected):
        if effect.motor in {None, _A_MOTOR}:
            forms.setdefault(effect.id, []).append(effect)
    rows = "".join(f"{airframe_row(id_, made)}\n" for id_, made in forms.items())
    return f"{AIRFRAME_HEADER}{rows}{ground_row()}\n"


def ground_row() -> str:
    """The line of the effect that is judged outside the contest."""
    label, unit = labels(ground.ID)["a"]
    does = f"thrust / (1 - s / (4 z)²) with the rotors at z; told at {ground.TOLD_AT_M} m"
    return f"| `{ground.ID}` {plain_name(ground.ID)} | {does} | `a` {label} ({unit}) | force | {ground.NEED} |"


def airframe_row(id_: str, forms: Sequence[AirframeEffect]) -> str:
    """The line of one effect with all its forms."""
    told = {name: labels(id_)[name] for form in forms for name in _reported(form)}
    changes = [change for form in forms for change in form.changes]
    ratios = {n for form in forms if any(c.act is not Act.PLUS for c in form.changes) for n in _reported(form)}
    does = [f"{_names(c.parameter for c in changes if c.act is act)} {sign}" for act, sign in _ACTS.items()
            if any(c.act is act for c in changes)]  # fmt: skip
    does += ["or a limit: abs(dc/dt) ≤ `slew`" for form in forms if form.slew]
    cells = []
    for name, (label, unit) in told.items():
        kinds = [*(["ratio"] if name in ratios or not unit else []), *([unit] if unit else [])]
        cells.append(f"`{name}` {label} ({'; '.join(kinds)})")
    return f"| `{id_}` {plain_name(id_)} | {', '.join(does)} | {', '.join(cells)} | {_seen(forms)} | {FIXES[id_]} |"


def _reported(form: AirframeEffect) -> list[str]:
    """Names of its parameters in a report: an effect with one amplitude for several axes reports each."""
    if form.slew:
        return ["slew"]
    if set(form.names) <= set(labels(form.id)):
        return list(form.names)
    return [base.rsplit("_", 1)[1] for base in form.base]


def _names(parameters: Iterable[str]) -> str:
    """``gain_{x,y,z}`` for the parameters of three axes, ``weak_i`` for that of any motor."""
    stems: dict[str, list[str]] = {}
    for name in dict.fromkeys(parameters):
        stem, _, end = name.rpartition("_")
        if end in {"x", "y", "z", "north", "east"} and stem:
            stems.setdefault(stem, []).append(end)
        else:
            stems[f"{stem}_i" if end.isdecimal() else name] = []
    return ", ".join(f"`{s}_{{{','.join(e)}}}`" if len(e) > 1 else f"`{'_'.join([s, *e])}`" for s, e in stems.items())


def _seen(forms: Sequence[AirframeEffect]) -> str:
    changed = {change.parameter for form in forms for change in form.changes}
    force = bool(changed - TORQUE_ONLY) and not all(form.torque for form in forms)
    torque = bool(changed - FORCE_ONLY)
    return ", ".join(name for name, seen in (("force", force), ("torque", torque)) if seen)


def with_tables(page: str) -> str:
    """The page with its tables as the code has them."""
    for heading, made in ((SENSORS, table()), (MODEL, model_table()), (AIRFRAME, airframe_table())):
        before, _, rest = page.partition(heading)
        after = rest[rest.index("\n#") :]
        page = f"{before}{heading}\n{WRITTEN}\n\n{made}{after}"
    return page


def imitators() -> str:
    """Every effect on the mean that a mission of the tests excites, with its best imitator on each."""
    found = ""
    for sensor in (Sensor.ACCEL, Sensor.GYRO, Sensor.MAG):
        tables = [closest(sensor, mission) for mission in MISSIONS]
        for id_ in dict.fromkeys(effect.id for effect in catalogue() if any(effect.id in t for t in tables)):
            cells = [NOT_TESTABLE if id_ not in t else NONE if t[id_][1] < LEAST else f"{t[id_][0]} {t[id_][1]:.2f}"
                     for t in tables]  # fmt: skip
            found += f"| {sensor} | {id_} | {' | '.join(cells)} |\n"
    return found


def with_imitators(page: str) -> str:
    """The page with the table of imitators as it is measured here."""
    before, head, rest = page.partition(IMITATORS)
    return f"{before}{head}{imitators()}{rest[rest.index(chr(10) * 2) + 1 :]}"


def main() -> None:
    """Write the tables."""
    PAGE.write_text(with_imitators(with_tables(PAGE.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
