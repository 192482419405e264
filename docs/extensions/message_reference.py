"""Directive for the messages that are met most, from ``docs/reference/messages.yaml``.

::

    ```{messages}
    ```

Each stands there with the design and the command that provoke it, which the tests do.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from docutils import nodes
from entries import Entry, entry_list, facts
from sphinx.util.docutils import SphinxDirective

if TYPE_CHECKING:
    from sphinx.application import Sphinx

LIST = Path(__file__).resolve().parents[1] / "reference" / "messages.yaml"


@dataclass(frozen=True, slots=True)
class Message:
    """A line of the standard error, with what it means and what provokes it.

    In the design ``written`` stands instead of something, or ``added`` behind the rest.
    """

    name: str
    command: str
    says: str
    code: int
    means: str
    remedy: str
    instead_of: str = ""
    written: str = ""
    added: str = ""


def messages() -> tuple[str, dict[tuple[str, str], list[Message]]]:
    """The design that all begin with, and the messages by title and text of their family."""
    read = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    families = {
        (family["title"], family.get("about", "")): [
            Message(**message) for message in family["messages"]
        ]
        for family in read["families"]
    }
    return read["design"], families


class Messages(SphinxDirective):
    """The families of messages, each in a section of its own."""

    def run(self) -> list[nodes.Node]:
        """Nodes in place of the directive."""
        self.env.note_dependency(str(LIST))
        _, families = messages()
        return [self._family(*names, listed) for names, listed in families.items()]

    def _family(self, title: str, about: str, listed: list[Message]) -> nodes.section:
        made = nodes.section("", nodes.title("", title), ids=[nodes.make_id(title)])
        if about:
            made += self.parse_text_to_nodes(about)
        made += entry_list(self.env, "message", [self._entry(message) for message in listed])
        return made

    def _entry(self, message: Message) -> Entry:
        told = self.parse_text_to_nodes(f"{message.means} {message.remedy}")
        changed = (message.written or message.added).strip()
        provoked = {
            "after": (message.command,),
            "with": tuple(line.strip() for line in changed.splitlines()),
            "without": (message.instead_of.strip(),) if message.instead_of and not changed else (),
        }
        line = message.says.removeprefix("dqforge: ")
        remarks = (f"exit code {message.code}",)
        label = f"message {message.name}"
        return Entry(message.name, label, line, "", remarks, (*told, *facts(provoked)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the directive, and a role that links to messages."""
    app.add_object_type("message", "message", objname="message")
    app.add_directive("messages", Messages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
