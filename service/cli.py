"""The command line: a table of commands, each loaded when it is named."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence

import click

from mavcal import calib
from mavcal.calib.errors import CalibError
from mavcal.service.commands.output import EXIT_NO, EXIT_USAGE, AnsweredNo, wants_json, write_json
from mavcal.service.errors import JobError, LinkDown, ServiceError, VehicleError
from mavcal.service.lifetime import follow
from mavcal.service.loading import loading

COMMANDS = {
    "demo": "Calibrate a simulated vehicle end to end and compare with its truth.",
    "serve": "Run the service and its panel.",
    "worker": "Compute fits and diagnoses for a fleet on PostgreSQL.",
    "preflight": "Check in ten seconds whether a vehicle is fit to fly.",
    "calibrate": "Calibrate one sensor of a vehicle, headless.",
    "campaign": "Check, calibrate, fit or diagnose many vehicles or logs as one job.",
    "plan": "Plan the fit of a recording for a connected vehicle, and write it.",
    "accept": "Write the plan of a job that waits in review.",
    "restore": "Put the last verified calibration back, say after a firmware change.",
    "revert": "Take back what a job has written.",
    "status": "Show which vehicles a link reaches, and what was calibrated last.",
    "fleet": "List every unit: preflights, ages, drifts, and who should be calibrated again.",
    "jobs": "List the jobs of a data directory or of a running service, of every kind.",
    "follow": "Show what happens to a job of a running service, and answer its prompts.",
    "answer": "Answer the prompt of a job of a running service.",
    "cancel": "Cancel a job of a running service.",
    "recover": "Finish or take back a write that was interrupted.",
    "fit": "Run one method on a recording.",
    "inspect": "Show what is in a recording, and whether its sensors are sound.",
    "convert": "Turn a recording into a table.",
    "gap": "Diagnose where a real sensor differs from a simulated one, and why.",
    "simulate": "A simulated flight controller or a flying vehicle on a socket, or a synthetic recording.",
    "audit": "Check that the audit trail is as it was written.",
    "config": "Show the settings, or their schema.",
    "doctor": "Check this machine for what the service needs.",
}
ANSWERS = (VehicleError, JobError, LinkDown)
"""Errors that are a negative answer of the vehicle, not wrong use."""


class LazyGroup(click.Group):
    """Imports ``service.commands.<name>`` when that command is asked for, so that help costs nothing."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name; None: there is none."""
        if cmd_name not in COMMANDS:
            return None
        with loading():
            command = importlib.import_module(f"mavcal.service.commands.{cmd_name}").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The table, without importing anything."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(calib.__version__, prog_name="mavcal")
def cli() -> None:
    """Calibrate the sensors of MAVLink vehicles, and prove that the result took effect.

    Exit codes: 0 done; 1 the answer is no (a failed check, a refused fit); 2 wrong use or unreadable input; 3 done in
    part (a sensor left out, a proof that is partial where a full one was asked, a preflight that warns).
    """


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; every expected error is one sentence on stderr and an exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    follow()
    try:
        code = cli.main(args=list(arguments), prog_name="mavcal", standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        sys.exit(EXIT_USAGE)
    except AnsweredNo as error:
        _complain(arguments, error.code, error.message)
        sys.exit(error.ends_with)
    except click.ClickException as error:
        _complain(arguments, "usage", _usage(error))
        sys.exit(EXIT_USAGE)
    except (click.Abort, KeyboardInterrupt):
        click.echo("stopped", err=True)
        sys.exit(130)
    except CalibError as error:
        _complain(arguments, type(error).__name__, str(error))
        sys.exit(EXIT_USAGE)
    except ServiceError as error:
        _complain(arguments, error.code, str(error))
        sys.exit(EXIT_NO if isinstance(error, ANSWERS) else EXIT_USAGE)
    except BrokenPipeError:
        sys.exit(0)
    sys.exit(code if isinstance(code, int) else 0)


def _usage(error: click.ClickException) -> str:
    """The message on one line; where it names nothing that would do, with the help to ask for."""
    message = " ".join(error.format_message().split())
    bare = message.startswith(("Missing", "No such")) and "Choose from" not in message
    if not bare or not isinstance(error, click.UsageError) or error.ctx is None:
        return message
    return f"{message.rstrip('.')}: see `{error.ctx.command_path} --help`"


def _complain(arguments: Sequence[str], code: str, message: str) -> None:
    click.echo(f"mavcal: {message}", err=True)
    if wants_json(arguments):
        write_json({"error": {"code": code, "detail": message}})
