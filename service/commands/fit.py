"""``mavcal fit``: one command a method; a method is loaded when it is named."""

from __future__ import annotations

import click

from mavcal.calib.methods import METHODS
from mavcal.calib.methods.names import ENTRIES


class MethodGroup(click.Group):
    """The methods as commands."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of the table."""
        return list(METHODS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that method; None: there is none."""
        if cmd_name not in METHODS:
            return None
        from mavcal.service.commands.fit_method import command_of

        return command_of(METHODS[cmd_name])

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The table, without loading a method."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.summary) for name, entry in ENTRIES.items()])


@click.group(cls=MethodGroup)
def command() -> None:
    """Run one method on a recording: a log (.tlog, DataFlash .bin or text, ULog) or a table (.csv, .npz, .mat ...).

    Exit code 1 if the data do not allow the fit.
    """
