"""Lists of keys, options and their like: each with an anchor that leads to it."""

from __future__ import annotations

from dataclasses import dataclass, field

from docutils import nodes
from sphinx.environment import BuildEnvironment


@dataclass(frozen=True, slots=True)
class Entry:
    """What a list says of one name.

    ``anchor`` is its id on the page, ``label`` the name under which other pages find it,
    ``shown`` what is written, ``remarks`` stand small beside it, ``facts`` below its meaning.
    """

    anchor: str
    label: str
    shown: str
    meaning: str
    remarks: tuple[str, ...] = ()
    facts: tuple[nodes.Node, ...] = field(default=())


def entry_list(env: BuildEnvironment, kind: str, entries: list[Entry]) -> nodes.Node:
    """A list of definitions, each of which other pages, and the search, can find.

    Args:
        env: What is known of the site so far.
        kind: Type of object, as `setup` of the extension names it.
        entries: In their order.
    """
    made = nodes.definition_list(classes=["simple", "entries"])
    for entry in entries:
        note(env, kind, entry.label, entry.anchor)
        term = nodes.term("", "", nodes.literal("", entry.shown), ids=[entry.anchor])
        for remark in entry.remarks:
            strong = ["strong"] if remark in ("required", "repeatable", "former name") else []
            term += [nodes.Text(" "), nodes.inline("", remark, classes=["remark", *strong])]
        term += permalink(entry.anchor)
        definition = nodes.definition("", *paragraphs(entry.meaning), *entry.facts)
        made += nodes.definition_list_item("", term, definition)
    return made


def note(env: BuildEnvironment, kind: str, label: str, anchor: str) -> None:
    """Let references and the search find an anchor of the page that is read."""
    domain = env.domains.standard_domain
    domain.note_object(kind, label, anchor)
    domain.note_hyperlink_target(label.lower(), env.docname, anchor, label)


def permalink(anchor: str) -> nodes.reference:
    """The sign behind a name that leads to itself."""
    return nodes.reference("", "\N{PILCROW SIGN}", refuri=f"#{anchor}", classes=["headerlink"])


def paragraphs(text: str) -> list[nodes.Node]:
    """A text of one or several paragraphs."""
    return [nodes.paragraph("", part.strip()) for part in text.split("\n\n") if part.strip()]


def facts(named: dict[str, tuple[str, ...]]) -> tuple[nodes.Node, ...]:
    """A line such as "one of mtpa, id0; default mtpa", its words as code; nothing for none."""
    line = nodes.paragraph(classes=["facts"])
    for name, words in named.items():
        if not words:
            continue
        part = nodes.inline("", "", nodes.Text(f"{name} "), classes=["fact"])
        for index, word in enumerate(words):
            part += [nodes.Text(", " if index else ""), nodes.literal("", word)]
        line += [nodes.Text("; ")] * bool(len(line)) + [part]
    return (line,) if len(line) else ()
