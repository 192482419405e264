"""Directives for the keys of the design file and of the study file, from their schemas.

::

    ```{design-keys} machine
    ```

lists every key of the section, and of the mappings within it, each in a section of its own;
without a name only the keys of the top. ``{study-keys}`` lists those of the study file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from docutils import nodes
from entries import Entry, entry_list, facts, paragraphs
from schema_keys import Group, Key, Schema, groups
from sphinx.util.docutils import SphinxDirective

from dqforge.machines.design.schema import json_schema
from dqforge.machines.exploration.study import study_json_schema

if TYPE_CHECKING:
    from sphinx.application import Sphinx


class _Keys(SphinxDirective):
    """Keys of a file, below the heading that the page gives."""

    optional_arguments = 1
    kind: ClassVar[str]
    prefix: ClassVar[str] = ""

    def schema(self) -> Schema:
        """JSON Schema of the file."""
        raise NotImplementedError

    def run(self) -> list[nodes.Node]:
        """Nodes in place of the directive."""
        start = self.arguments[0] if self.arguments else ""
        found = groups(self.schema(), start)
        if not start and self.kind == "key":
            found = found[:1]
        made: list[nodes.Node] = []
        self._seen: set[str] = set()
        for group in found:
            body = [*paragraphs(group.meaning), self._list(group)]
            if group.path == start and not made:
                made += body
            else:
                made.append(self._section(group, body))
        return made

    def _section(self, group: Group, body: list[nodes.Node]) -> nodes.section:
        shown = group.path + (": each entry" if group.listed else "")
        anchor = self._own(f"keys-of-{group.path}")
        made = nodes.section("", nodes.title("", "", nodes.literal("", shown)), ids=[anchor])
        made += body
        return made

    def _list(self, group: Group) -> nodes.Node:
        return entry_list(self.env, self.kind, [self._entry(key) for key in group.keys])

    def _entry(self, key: Key) -> Entry:
        form = f"{key.form} ({key.unit})" if key.unit else key.form
        remarks = [form, *["required"] * key.required, *["former name"] * key.former]
        fixed = key.required and len(key.choices) == 1
        said = facts(
            {
                "one of": () if len(key.choices) == 1 else key.choices,
                "always": key.choices if fixed else (),
                "kind": key.kinds,
                "default": (key.default,) if key.default else (),
                "such as": key.examples,
            }
        )
        anchor = self._own(key.path)
        label = self.prefix + anchor
        return Entry(anchor, label, key.name, key.meaning, tuple(remarks), said)

    def _own(self, anchor: str) -> str:
        """An anchor that no other key of the page has: two forms of a mapping may share keys."""
        while anchor in self._seen:
            anchor += "-2"
        self._seen.add(anchor)
        return anchor


class DesignKeys(_Keys):
    """Keys of a section of the design file, or those of its top."""

    kind = "key"

    def schema(self) -> Schema:
        """JSON Schema of the design file."""
        return json_schema()


class StudyKeys(_Keys):
    """Keys of the study file."""

    kind = "study-key"
    prefix = "study "

    def schema(self) -> Schema:
        """JSON Schema of the study file."""
        return study_json_schema()


def setup(app: Sphinx) -> dict[str, Any]:
    """Offer the directives, and roles that link to keys."""
    app.add_object_type("key", "key", objname="key of the design file")
    app.add_object_type("study-key", "study-key", objname="key of the study file")
    app.add_directive("design-keys", DesignKeys)
    app.add_directive("study-keys", StudyKeys)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
