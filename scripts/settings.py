"""``scripts/settings``: the table of settings in ``docs/settings.md``, as the code has them."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel

from mavcal.service.settings import Settings

PAGE = Path(__file__).resolve().parents[1] / "docs" / "settings.md"
HEAD = "| setting | environment | default | meaning |\n|---|---|---|---|\n"


def settings_table() -> str:
    """The settings as a Markdown table."""
    rows = _rows(Settings, "", "MAVCAL_")
    return HEAD + "".join(f"| `{name}` | `{env}` | `{default}` | {text} |\n" for name, env, default, text in rows)


def _rows(model: type[BaseModel], prefix: str, env: str) -> list[tuple[str, str, str, str]]:
    rows: list[tuple[str, str, str, str]] = []
    for name, info in model.model_fields.items():
        annotation = info.annotation
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            rows += _rows(annotation, f"{prefix}{name}.", f"{env}{name.upper()}__")
            continue
        default = (
            "the platform's state directory"
            if name == "data_dir"
            else repr(info.get_default(call_default_factory=True))
        )
        rows.append((prefix + name, env + name.upper(), default, info.description or ""))
    return rows


def main() -> None:
    """Write the table into docs/settings.md."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(HEAD)
    after = "".join(line for line in rest.splitlines(keepends=True) if not line.startswith("|"))
    PAGE.write_text(f"{before}{settings_table()}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
