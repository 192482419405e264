"""The keys of a file from its JSON Schema: what stands at each, in words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from dqforge.machines.units.registry import DIMENSIONS

Schema = dict[str, Any]

_ORIGIN = {"value", "kind", "source", "inferred", "note"}
"""Keys of the mapping that every quantity may be written as."""

_UNITS = {(each.name, each.example): each.unit for each in DIMENSIONS.values()}


_PLAIN = "a plain number"


@dataclass(frozen=True, slots=True)
class Key:
    """One key.

    ``path`` is dotted, from the top of the file; ``form`` says in words what stands there,
    ``choices`` are words to choose from, ``kinds`` the conventions of a quantity; ``former`` names
    are still read.
    """

    path: str
    required: bool
    form: str
    meaning: str
    choices: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    examples: tuple[str, ...] = ()
    default: str = ""
    unit: str = ""
    former: bool = False

    @property
    def name(self) -> str:
        """Last part of the path."""
        return self.path.rpartition(".")[2]


@dataclass(frozen=True, slots=True)
class Group:
    """A mapping of the file with its keys; ``listed`` where it is an entry of a list."""

    path: str
    meaning: str
    keys: tuple[Key, ...]
    listed: bool = False


def groups(schema: Schema, start: str = "") -> list[Group]:
    """Mappings of a file in the order of its schema, each before those within it.

    Args:
        schema: JSON Schema of the whole file.
        start: Dotted key to begin at, or the top.
    """
    node = schema
    for name in start.split(".") if start else ():
        node = node["properties"][name]
    return list(_groups(schema, node, start, listed=False))


def _groups(schema: Schema, node: Schema, path: str, listed: bool) -> Iterator[Group]:
    for mapping in _mappings(schema, node):
        required = mapping.get("required", [])
        entries = mapping["properties"].items()
        keys = tuple(
            _key(schema, entry, f"{path}.{name}".lstrip("."), name in required)
            for name, entry in entries
        )
        yield Group(path, mapping.get("description", ""), keys, listed)
        for name, entry in entries:
            inner = f"{path}.{name}".lstrip(".")
            items = _list_of(entry)
            yield from _groups(schema, items or entry, inner, listed=bool(items))


def _mappings(schema: Schema, node: Schema) -> Iterator[Schema]:
    """The mappings with keys of their own that may stand at a node."""
    if "$ref" in node:
        yield from _mappings(schema, schema["$defs"][node["$ref"].rpartition("/")[2]])
    for form in _forms(node):
        yield from _mappings(schema, form)
    closed = node.get("additionalProperties") is False
    if closed and "properties" in node and "inferred" not in node["properties"]:
        yield node


def _forms(node: Schema) -> list[Schema]:
    return [*node.get("anyOf", ()), *node.get("oneOf", ())]


def _list_of(node: Schema) -> Schema | None:
    items = node.get("items") if node.get("type") == "array" else None
    return items if isinstance(items, dict) else None


def _key(schema: Schema, entry: Schema, path: str, required: bool) -> Key:
    quantity = _quantity(entry)
    value = quantity.get("value", {}).get("description", "")
    name, _, example = value.replace("'", "").partition(", such as ")
    kind = quantity.get("kind", {})
    said = {kind["default"]: f"{kind['default']} (default)"} if "default" in kind else {}
    return Key(
        path=path,
        required=required,
        form=_form(schema, entry),
        meaning=_meaning(schema, entry),
        choices=tuple(str(each) for each in _choices(schema, entry)),
        kinds=tuple(said.get(each, each) for form in _forms(kind) for each in form.get("enum", ())),
        examples=() if name == _PLAIN else tuple(entry.get("examples", [example] if name else [])),
        default=_default(entry),
        unit=_UNITS.get((name, example), ""),
        former=bool(entry.get("deprecated")),
    )


def _quantity(entry: Schema) -> Schema:
    """Properties of the mapping that a quantity may be written as; nothing for other entries."""
    for form in (entry, *_forms(entry)):
        properties = form.get("properties", {})
        if "value" in properties and set(properties) <= _ORIGIN:
            return dict(properties)
    return {}


def _meaning(schema: Schema, entry: Schema) -> str:
    if "description" in entry:
        return str(entry["description"])
    named = schema["$defs"][entry["$ref"].rpartition("/")[2]]
    forms = [named, *_forms(named)]
    return next(str(form["description"]) for form in forms if "description" in form)


def _choices(schema: Schema, entry: Schema) -> list[Any]:
    if "$ref" in entry:
        return _choices(schema, schema["$defs"][entry["$ref"].rpartition("/")[2]])
    if "items" in entry and isinstance(entry["items"], dict):
        return _choices(schema, entry["items"])
    found = list(entry.get("enum", [entry["const"]] if "const" in entry else []))
    for form in _forms(entry):
        found += [each for each in _choices(schema, form) if each not in found]
    return found


def _default(entry: Schema) -> str:
    if "default" not in entry or entry["default"] in ("", []):
        return ""
    value = entry["default"]
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)


def _form(schema: Schema, entry: Schema) -> str:
    """What stands at a key, in words."""
    if "$ref" in entry:
        return _form(schema, schema["$defs"][entry["$ref"].rpartition("/")[2]])
    if quantity := _quantity(entry):
        return _quantity_form(entry, quantity["value"])
    if forms := _forms(entry):
        return " or ".join(dict.fromkeys(_form(schema, form) for form in forms))
    return _plain_form(schema, entry)


def _plain_form(schema: Schema, entry: Schema) -> str:
    """The same for what is neither a quantity nor a choice of forms."""
    if "const" in entry or "enum" in entry:
        return "number" if isinstance(entry.get("const"), int) else "word"
    kind = entry.get("type", "any")
    if isinstance(kind, list):
        return " or ".join(_WORDS[each] for each in kind)
    if kind in ("integer", "number"):
        return f"{_WORDS[kind]}{_limits(entry)}"
    if kind == "array" and ("items" in entry or "prefixItems" in entry):
        items = entry.get("items") or entry["prefixItems"][0]
        return f"list, each {_with_article(_form(schema, items))}"
    return _WORDS[kind]


def _quantity_form(entry: Schema, value: Schema) -> str:
    """A quantity by its name, a count by its limits; both sides where they may differ."""
    name = value.get("description", "").partition(", such as ")[0]
    form = {"": f"whole number{_limits(value)}", _PLAIN: "number, or share in %"}.get(name)
    sides = any("from" in each.get("properties", {}) for each in _forms(entry))
    return (form or name.partition(" ")[2]) + (", or {from: ..., to: ...}" if sides else "")


def _with_article(form: str) -> str:
    return f"{'an' if form[0] in 'aeiou' else 'a'} {form}"


_WORDS = {
    "any": "any value",
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "object": "mapping",
    "array": "list",
}


def _limits(entry: Schema) -> str:
    low, high = entry.get("minimum"), entry.get("maximum")
    above, below = entry.get("exclusiveMinimum"), entry.get("exclusiveMaximum")
    least = f"from {low:g}" if low is not None else f"above {above:g}" if above is not None else ""
    most = f"to {high:.9g}" if high is not None else f"below {below:g}" if below is not None else ""
    joined = " ".join(part for part in (least, most) if part)
    return f", {joined}" if joined else ""
