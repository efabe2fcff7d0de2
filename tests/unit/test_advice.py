"""Every option that a sentence of the product tells somebody to use exists, on the command line and over REST."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import click
import pytest

from mavcal.calib.firmware.options import PLAN_OPTIONS
from mavcal.calib.methods import METHODS
from mavcal.calib.procedures.registry import PROCEDURES
from mavcal.service.api.models.jobs import JobRequest
from mavcal.service.api.models.plans import PlanOptions, PlanRequest
from mavcal.service.api.models.recordings import RecordingJobRequest
from mavcal.service.cli import COMMANDS, cli
from mavcal.service.commands import plan_options as command_line

ROOT = Path(__file__).resolve().parents[2]
FLAG = re.compile(r"(?<![\w-])--([a-z][a-z0-9-]*)")
NAMED = re.compile(r"\b(?:the plan option|plan with|option) ([a-z]+(?:_[a-z]+)*_[a-z]+)\b")
ELSEWHERE = ("calib/gap_report/", "service/simvehicle/", "service/link/local.py")
"""Style sheets, whose variables look like flags, and a program with a command line of its own and who starts it."""


@cache
def sentences() -> tuple[tuple[str, str], ...]:
    return tuple(_sentences())


def _sentences() -> Iterator[tuple[str, str]]:
    """Every string of the sources; the parts of an f-string as one, without what is put in."""
    for path in sorted([*(ROOT / "calib").rglob("*.py"), *(ROOT / "service").rglob("*.py")]):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        inside: set[int] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                inside |= {id(part) for part in node.values}
                text = "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
                yield str(path.relative_to(ROOT)), text
            elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside:
                yield str(path.relative_to(ROOT)), node.value


def flags(command: click.Command) -> Iterator[str]:
    for parameter in command.params:
        yield from (name.lstrip("-") for name in (*parameter.opts, *parameter.secondary_opts))
    if isinstance(command, click.Group):
        for name in command.list_commands(click.Context(command)):
            found = command.get_command(click.Context(command), name)
            if found is not None:
                yield from flags(found)


@pytest.fixture(scope="module")
def known_flags() -> set[str]:
    assert COMMANDS
    return {*flags(cli), "help", "version"}


def test_every_flag_in_a_sentence_exists(known_flags: set[str]) -> None:
    told = {(flag, path) for path, text in sentences() if not path.startswith(ELSEWHERE) for flag in FLAG.findall(text)}
    assert len(told) > 20
    begun = {name[: k + 1] for name in known_flags for k, letter in enumerate(name) if letter == "-"}  # --unit-{}
    assert {(flag, path) for flag, path in told if flag not in known_flags | begun} == set()


def test_every_option_that_is_named_in_a_sentence_exists() -> None:
    options = {*PLAN_OPTIONS}
    options |= {o.name for spec in PROCEDURES.values() for o in spec.options}
    options |= {o.name for method in METHODS.values() for o in method.options}
    told = {(name, path) for path, text in sentences() for name in NAMED.findall(text)}
    assert {(name, path) for name, path in told if name not in options} == set()


@pytest.mark.long
def test_advice_on_a_plan_is_made_of_the_table_of_its_options() -> None:
    """No sentence names a plan option by hand: `how` does, and refuses a name that is not in the table."""
    by_hand = [
        (path, text)
        for path, text in sentences()
        for name in PLAN_OPTIONS
        if "_" in name and re.search(rf"\b(with|give|option|plan) {name}\b", text)
    ]
    assert [found for found in by_hand if "options.py" not in found[0]] == []


def test_both_faces_take_every_option_of_a_plan() -> None:
    assert set(PlanOptions.model_fields) == set(PLAN_OPTIONS)
    for model in (JobRequest, PlanRequest, RecordingJobRequest):
        assert model.model_fields["plan_options"].annotation in (PlanOptions, PlanOptions | None)
    live = {name for name, option in PLAN_OPTIONS.items() if option.live}
    assert set(command_line.NAMES) == live
    assert {*command_line.NAMES, *command_line.OF_RECORDINGS} == set(PLAN_OPTIONS)
    for name, taken in (("calibrate", live), ("plan", PLAN_OPTIONS), ("accept", PLAN_OPTIONS)):
        command = cli.get_command(click.Context(cli), name)
        assert command is not None
        assert set(flags(command)) >= {PLAN_OPTIONS[option].flag for option in taken}


def test_what_the_command_line_is_given_is_what_a_plan_takes() -> None:
    @click.command()
    @command_line.plan_options
    def command(**options: object) -> None:
        said.update(command_line.given(options))
        assert not options

    said: dict[str, object] = {}
    line = (
        "--only gyro0,accel1 --keep-gyro-at-boot --no-adjust-level --device-ids gyro0=7 --accel-temperature accel0=3.5"
    )
    command.main(line.split(), standalone_mode=False)
    assert said == {
        "only": ["gyro0", "accel1"],
        "keep_gyro_at_boot": True,
        "adjust_level": False,
        "device_ids": {"gyro0": 7.0},
        "accel_temperature": {"accel0": 3.5},
    }
    said.clear()
    command.main([], standalone_mode=False)
    assert said == {}
    with pytest.raises(click.UsageError, match="SENSOR=NUMBER"):
        command.main(["--device-ids", "gyro0"], standalone_mode=False)
