"""The types for browsers hold, and a code generator of another language reads the document without a warning.

Both need npm, and the packages from the network or its cache; without them the tests skip.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.patience import scaled

ROOT = Path(__file__).resolve().parents[2]
FOREIGN = ROOT / ".venv" / "foreign" / "bin"
"""A generator of Python clients with what it needs, apart from what we need."""
TYPES = ROOT / "web" / "mavcal.d.ts"
TYPESCRIPT, GENERATOR = "typescript@5", "openapi-typescript@7"
MODERN = [
    "--target",
    "es2022",
    "--module",
    "esnext",
    "--moduleResolution",
    "bundler",
    "--lib",
    "dom,dom.iterable,es2022",
]
PAGE = ["--strict", *MODERN, "--allowJs", "--checkJs", "--allowImportingTsExtensions"]

pytestmark = [pytest.mark.long, pytest.mark.timeout(300)]


class Npm:
    """Commands of npm packages, in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        packages = [f"--package={name}" for name in (TYPESCRIPT, GENERATOR)]
        command = ["npm", "exec", "--yes", "--loglevel=error", *packages, "--", *words]
        return subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, check=False, timeout=scaled(240.0)
        )

    def compile(self, name: str, text: str) -> subprocess.CompletedProcess[str]:
        """The verdict of the strict compiler on a program."""
        (self.folder / name).write_text(text)
        return self.run("tsc", "--noEmit", "--strict", *MODERN, name)


@pytest.fixture(scope="module")
def npm(tmp_path_factory: pytest.TempPathFactory) -> Npm:
    if shutil.which("npm") is None:
        pytest.skip("there is no npm")
    npm = Npm(tmp_path_factory.mktemp("npm"))
    asked = npm.run("tsc", "--version")
    if asked.returncode:
        pytest.skip(f"npm cannot get TypeScript here: {asked.stderr.strip()[-200:]}")
    return npm


PROGRAM = """
import type {{ JobEvent, JobModel, Message, Operations }} from "{types}";

export function told(event: JobEvent): string {{
  switch (event.kind) {{
    case "state": return event.data.state;
    case "warning": return event.data.text;
    case "write": return event.data.{cause};
    default: return event.kind;
  }}
}}
export const cause = (job: JobModel): string | null =>
  job.outcome === null ? null : job.outcome.kind === "result" ? job.outcome.text : job.outcome.cause;
export const id = (message: Message): string => message.event === "job" ? message.id : message.data.id;
export const body: Operations["apply_plan"]["body"] = {{ plan_sha256: "0" }};
"""


def test_a_program_is_checked_against_the_types(npm: Npm) -> None:
    types = str(TYPES).removesuffix(".d.ts")
    good = npm.compile("good.ts", PROGRAM.format(types=types, cause="cause"))
    assert good.returncode == 0, good.stdout
    bad = npm.compile("bad.ts", PROGRAM.format(types=types, cause="reason"))
    assert "'reason' does not exist on type 'WriteModel'" in bad.stdout


def test_the_panel_names_only_fields_that_there_are(npm: Npm) -> None:
    checked = npm.run("tsc", "--noEmit", *PAGE, str(ROOT / "web" / "main.js"))
    assert checked.returncode == 0, checked.stdout
    for name in ("web", "client"):
        shutil.copytree(ROOT / name, npm.folder / name)
    page = npm.folder / "web" / "view" / "job" / "dock.js"
    page.write_text(page.read_text().replace("plan.needs_reboot", "plan.needs_restart"))
    assert "needs_restart" in npm.run("tsc", "--noEmit", *PAGE, "web/main.js").stdout


def test_a_generator_of_another_language_reads_the_document_without_a_warning(npm: Npm) -> None:
    done = npm.run("openapi-typescript", str(ROOT / "docs" / "openapi.json"), "-o", "made.ts")
    assert done.returncode == 0, done.stderr
    assert "warn" not in (done.stdout + done.stderr).lower()
    made = (npm.folder / "made.ts").read_text()
    assert "apply_plan: {" in made
    assert npm.compile("whole.ts", made).returncode == 0


OVERRIDES = """content_type_overrides:
  image/svg+xml: application/octet-stream
  text/event-stream: application/json
"""
"""What openapi-python-client has to be told: it knows neither pictures nor streams of events."""


def test_a_generator_of_python_makes_every_operation_and_every_problem(tmp_path: Path) -> None:
    """Its warnings name what it drops; the answers of errors have their types, and mypy accepts what it made."""
    if not (FOREIGN / "openapi-python-client").is_file():
        pytest.skip("there is no openapi-python-client: .ci/run brings it into .venv/foreign")
    document, made = ROOT / "docs" / "openapi.json", tmp_path / "made"
    (tmp_path / "config.yml").write_text(OVERRIDES)
    found = {**os.environ, "PATH": f"{FOREIGN}{os.pathsep}{os.environ['PATH']}"}

    def run(*words: str) -> str:
        done = subprocess.run(
            words, cwd=tmp_path, env=found, capture_output=True, text=True, check=False, timeout=scaled(240.0)
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr

    options = ("--path", str(document), "--config", "config.yml", "--meta", "none", "--output-path", str(made))
    said = run(str(FOREIGN / "openapi-python-client"), "generate", *options)
    assert "warning" not in said.lower(), said
    operations = [o for m in json.loads(document.read_text())["paths"].values() for o in m.values()]
    assert {operation["operationId"] for operation in operations} <= {p.stem for p in (made / "api").rglob("*.py")}
    assert "Problem401" in (made / "api" / "jobs" / "get_job.py").read_text()
    own = ("--no-incremental", "--follow-imports=silent", "made/api", "made/models")  # its template is not ours
    run(str(FOREIGN / "python"), "-m", "mypy", *own)


def test_the_overrides_that_the_page_of_the_client_names_are_those_of_the_test() -> None:
    assert all(line in (ROOT / "docs" / "client.md").read_text() for line in OVERRIDES.splitlines())
