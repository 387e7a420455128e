"""Where the keys of a file stand: what a JSON schema says of a place that pydantic names."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

Node = dict[str, Any]
DEEPEST = 5  # tables within tables


@dataclass(frozen=True)
class Place:
    """A place in a file.

    path : its key path as a person writes it; list entries count from 1, the tags of unions are left out
    names : the keys that stand in the table around it
    tag : which kind of that table it is, where there are several
    """

    path: str
    names: tuple[str, ...]
    tag: str = ""


class Schema:
    """The JSON schema of a file, asked for its places."""

    def __init__(self, schema: Node):
        self._root = schema
        self._definitions: Node = schema.get("$defs", {})

    def place(self, location: Sequence[str | int]) -> Place:
        """Place of a finding of pydantic, whose location also holds the tags of unions."""
        nodes, path, tag, told = self._members(self._root), "", "", False
        names: tuple[str, ...] = _keys(nodes)
        for i, part in enumerate(location):
            inside = list(self._inside(nodes, part))
            chosen = [] if told else _with_tag(nodes, str(part))
            told = False
            if isinstance(part, int):
                path, nodes = f"{path}[{part + 1}]", inside
            elif chosen and (not inside or i + 1 < len(location)):
                nodes, tag, told = chosen, str(part), True
            elif inside or (i + 1 == len(location) and part.isidentifier() and part not in _types(nodes)):
                names, path = _keys(nodes), f"{path}.{part}".lstrip(".")
                nodes, tag = inside, tag if i + 1 == len(location) else ""
        return Place(path, names, tag)

    def owners(self, name: str) -> list[Place]:
        """Tables that have a key of this name."""
        found: dict[tuple[str, str], Place] = {}
        for place in self._tables(self._members(self._root), "", 0):
            if name in place.names:
                found.setdefault((place.path, place.tag), place)
        return list(found.values())

    def names(self) -> list[str]:
        """Every key, whatever its table."""
        tables = self._tables(self._members(self._root), "", 0)
        return sorted({name for place in tables for name in place.names})

    def _tables(self, nodes: Sequence[Node], path: str, depth: int) -> Iterator[Place]:
        for node in nodes:
            properties = node.get("properties", {})
            if properties:
                yield Place(path, tuple(properties), _tag(node))
            if depth < DEEPEST:
                for key, value in properties.items():
                    below = self._members(value)
                    entries = [entry for member in below for entry in self._entries(member)]
                    yield from self._tables([*below, *entries], f"{path}.{key}".lstrip("."), depth + 1)

    def _members(self, node: Node) -> list[Node]:
        """The alternatives of a node, references followed."""
        if "$ref" in node:
            return self._members(self._definitions[node["$ref"].rpartition("/")[2]])
        alternatives = [*node.get("anyOf", ()), *node.get("oneOf", ())]
        if alternatives:
            return [member for alternative in alternatives for member in self._members(alternative)]
        return [node]

    def _entries(self, node: Node) -> list[Node]:
        items = node.get("items")
        return self._members(items) if isinstance(items, dict) else []

    def _inside(self, nodes: Sequence[Node], part: str | int) -> Iterator[Node]:
        for node in nodes:
            if isinstance(part, int):
                yield from self._entries(node)
            elif part in node.get("properties", {}):
                yield from self._members(node["properties"][part])
            elif isinstance(node.get("additionalProperties"), dict):
                yield from self._members(node["additionalProperties"])


def _keys(nodes: Sequence[Node]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for node in nodes for name in node.get("properties", {})))


def _tag(node: Node) -> str:
    """Value of the key that tells one kind of a table from the others."""
    constants = [value["const"] for value in node.get("properties", {}).values() if "const" in value]
    return str(constants[0]) if constants else ""


def _with_tag(nodes: Sequence[Node], tag: str) -> list[Node]:
    return [node for node in nodes if _tag(node) == tag]


def _types(nodes: Sequence[Node]) -> set[str]:
    """What pydantic calls the members of a union of plain values."""
    names = {"number": "float", "integer": "int", "string": "str", "boolean": "bool"}
    return {names.get(str(node.get("type")), "") for node in nodes}
