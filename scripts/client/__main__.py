"""``python -m scripts.client``: write the files; ``--check`` names those that are out of date and writes nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from scripts.client import javascript, python, sections, typescript
from scripts.client.spec import Document

ROOT = Path(__file__).resolve().parents[2]


def generated() -> dict[Path, str]:
    """The text of every generated file, by its place below the root."""
    document = Document(json.loads((ROOT / "docs" / "openapi.json").read_text(encoding="utf-8")))
    modules = {Path("client") / name: formatted(text, name) for name, text in python.emit(document).items()}
    web = {"mavcal.d.ts": typescript.emit(document), "operations.js": javascript.emit(document)}
    web["scene/sections.js"] = sections.emit()
    return {**modules, **{Path("web") / name: text for name, text in web.items()}}


def formatted(text: str, name: str) -> str:
    """`text` as ruff formats it here, with sorted imports."""
    for words in (["check", "--quiet", "--fix", "--select", "I"], ["format", "--quiet"]):
        command = [sys.executable, "-m", "ruff", *words, "--stdin-filename", str(ROOT / "client" / name), "-"]
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=False, cwd=ROOT)
        if not done.stdout:
            raise RuntimeError(f"{name}: {done.stderr}")
        text = done.stdout
    return text


def outdated() -> list[str]:
    """Files that are not as the document says."""
    return [
        str(path)
        for path, text in generated().items()
        if not (ROOT / path).exists() or (ROOT / path).read_text(encoding="utf-8") != text
    ]


def main() -> int:
    """Write or check."""
    if "--check" in sys.argv[1:]:
        wrong = outdated()
        print("\n".join(wrong))
        return 1 if wrong else 0
    for path, text in generated().items():
        (ROOT / path).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
