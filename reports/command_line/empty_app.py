"""The application that the commands join: name, help, and what it says without a command."""

from __future__ import annotations

import typer

from dqforge.reports.command_line import flags as given


def application() -> typer.Typer:
    """An application without commands, which shows its help and ends with 2 where none is given."""
    app = typer.Typer(
        name="dqforge",
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
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(2)
