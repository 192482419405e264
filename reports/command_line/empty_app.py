"""The application that the commands join: name, help, and what it says without a command."""

from __future__ import annotations

from typing import Any

import typer

from dqforge.reports.command_line import flags as given

GROUPS = {
    "Design": ("new", "check", "run"),
    "Analysis": ("mtpa", "fit", "tune", "losses", "dqy", "simulate", "estimators"),
    "Firmware": ("export", "explain", "verify"),
    "Data": ("bemf",),
    "Many": ("explore", "compare"),
    "Tools": ("machines", "schema", "doctor", "reproduce"),
}


class _Grouped(typer.core.TyperGroup):
    """Lists the commands by what they are for."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 - as click calls it
        for title, names in GROUPS.items():
            rows = [(name, self.commands[name].get_short_help_str(60)) for name in names]
            with formatter.section(title):
                formatter.write_dl(rows)


def application() -> typer.Typer:
    """An application without commands, which shows its help where none is given."""
    app = typer.Typer(
        name="dqforge",
        cls=_Grouped,
        help=(
            "Controller coefficients, loss budgets and checked C headers for permanent-magnet "
            "drives."
        ),
        epilog="DESIGN is a design file, or the name of a drive that 'dqforge machines' lists.",
        context_settings={"help_option_names": ["-h", "--help"]},
        invoke_without_command=True,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
    )
    app.callback()(_root)
    return app


def _root(context: typer.Context, _version: given.Version = False) -> None:
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit
