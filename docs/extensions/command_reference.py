"""Directive for the arguments and options of a command, from the application itself.

::

    ```{dqforge-command} check
    ```
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer
from docutils import nodes
from entries import Entry, entry_list, facts, note, paragraphs
from sphinx.util.docutils import SphinxDirective

from dqforge.cli import app as dqforge_app

if TYPE_CHECKING:
    from sphinx.application import Sphinx


class CommandOptions(SphinxDirective):
    """What a command does, how it is called, and what each argument and option means."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Nodes in place of the directive."""
        name = self.arguments[0]
        command = typer.main.get_command(dqforge_app).commands[name]  # type: ignore[attr-defined]
        note(self.env, "command", f"dqforge {name}", f"dqforge-{name}")  # of the heading above
        lists: list[nodes.Node] = []
        for kind, title in (("argument", "Arguments"), ("option", "Options")):
            found = [each for each in command.params if each.param_type_name == kind]
            if found:
                lists.append(nodes.paragraph("", title, classes=["of-entries"]))
                listed = [_entry(name, each) for each in found]
                lists.append(entry_list(self.env, "command-option", listed))
        usage = nodes.literal_block("", _usage(name, command.params), language="text")
        return [*paragraphs(command.help), usage, *lists]


def _usage(name: str, params: list[Any]) -> str:
    """One line: the command, its arguments, and that there are options."""
    words = [
        each.metavar if each.required else f"[{each.metavar}]"
        for each in params
        if each.param_type_name == "argument"
    ]
    return " ".join(["dqforge", name, *words, "[OPTIONS]"])


def _entry(command: str, param: Any) -> Entry:
    """An argument or an option, by the name under which it is typed."""
    if param.param_type_name == "argument":
        anchor = f"{command}-{param.name}"
        remarks = () if param.required else ("may be left out",)
        return Entry(
            anchor, f"dqforge {command} {param.metavar}", param.metavar, param.help, remarks
        )
    longest = max(param.opts, key=len)
    shown = ", ".join(param.opts) + (f" {param.metavar}" if param.metavar else "")
    default = (
        () if param.default is None or isinstance(param.default, bool) else (str(param.default),)
    )
    said = facts({"default": tuple(each for each in default if each)})
    remarks = ("repeatable",) if param.multiple else ()
    anchor, label = f"{command}{longest}", f"dqforge {command} {longest}"
    return Entry(anchor, label, shown, param.help, remarks, said)


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the directive, and roles that link to commands and their options."""
    app.add_object_type("command", "cmd", objname="command")
    app.add_object_type("command-option", "cmd-option", objname="option of a command")
    app.add_directive("dqforge-command", CommandOptions)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
