"""Validation of files: findings of pydantic as mistakes with place and remedy."""

import difflib
import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Self, cast

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from hammerstein.errors import InputError, Mistake

Node = dict[str, Any]
DEEPEST = 5  # tables within tables


class Place(NamedTuple):
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
            chosen = [] if told else [node for node in nodes if _tag(node) == str(part)]
            told = False
            if isinstance(part, int):
                path, nodes = f"{path}[{part + 1}]", inside
            elif chosen and (not inside or i + 1 < len(location)):
                nodes, tag, told = chosen, str(part), True
            elif inside or (i + 1 == len(location) and part.isidentifier() and part not in _types(nodes)):
                names, path = _keys(nodes), f"{path}.{part}".lstrip(".")
                nodes, tag = inside, tag if i + 1 == len(location) else ""
        return Place(path, names, tag)

    @cached_property
    def tables(self) -> list[Place]:
        """Every table, wherever it may stand."""
        return list(self._tables(self._members(self._root), "", 0))

    def owners(self, name: str) -> list[Place]:
        """Tables that have a key of this name."""
        return list({(place.path, place.tag): place for place in self.tables if name in place.names}.values())

    def names(self) -> list[str]:
        """Every key, whatever its table."""
        return sorted({name for place in self.tables for name in place.names})

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


def _types(nodes: Sequence[Node]) -> set[str]:
    """What pydantic calls the members of a union of plain values."""
    names = {"number": "float", "integer": "int", "string": "str", "boolean": "bool"}
    return {names.get(str(node.get("type")), "") for node in nodes}


MOST_SHOWN = 60  # characters of a value
ALIKE = 0.7  # how alike a key of another table must be to be named, from 0 to 1
MOST_OWNERS = 3
"""Tables that are named for a key in the wrong place."""
PLAIN = (
    ("Value error, ", ""),
    ("Input should be", "must be"),
    (", unable to parse string as a number", ""),
    (", unable to parse string as an integer", ""),
    ("String should", "must"),
    ("Tuple should", "must"),
    ("Dictionary should", "must"),
    (" after validation", ""),
    ("a valid integer", "a whole number"),
    ("a valid number", "a number"),
    ("a valid string", "text in quotes"),
    ("a valid boolean", "true or false"),
    ("a valid tuple", "a list"),
    ("a valid array", "a list"),
    ("a valid list", "a list"),
)
TABLE = {"model_type", "model_attributes_type", "dict_type", "dataclass_type"}


def mistakes_of(error: ValidationError, model: type[BaseModel] | TypeAdapter[Any]) -> list[Mistake]:
    """Every finding with its key path, what is wrong and the nearest known name.

    Parameters
    ----------
    error : what pydantic found
    model : what was wanted, whose schema says which key belongs where
    """
    schema = _schema_of(model)
    found: dict[str, list[dict[str, Any]]] = {}
    for finding in error.errors():
        if finding["type"] == "too_short" and finding["input"]:
            continue  # too short without the entries that are wrong themselves
        marked = finding["loc"][-1:] == ("[key]",)  # pydantic marks that the key is wrong and not its value
        place = schema.place(finding["loc"][: -1 if marked else None])
        found.setdefault(_where(dict(finding), place), []).append({**finding, "place": place})
    mistakes = [_mistake(where, findings, schema) for where, findings in found.items()]
    meant = {"".join((*m.where.rpartition(".")[:2], m.what.rpartition(" ")[2])) for m in mistakes}
    return [m for m in mistakes if m.what != "is missing" or f"{m.where}?" not in meant]


def with_nearest_kinds(data: Any, error: ValidationError) -> Any:
    """A copy with the nearest known kind in each table whose kind, or its key, is unknown.

    Its other keys can be judged then.

    data : what was validated, as JSON holds it; error : what pydantic found
    """
    copy = json.loads(json.dumps(data, default=str))
    for finding in error.errors():
        if finding["type"] not in ("union_tag_invalid", "union_tag_not_found"):
            continue
        node = copy
        for part in finding["loc"]:
            if isinstance(part, int) or part in node:  # it is not the tag of a union
                node = node[part]
        key = _tag_key(finding)
        if finding["type"] == "union_tag_not_found":
            for meant in nearest(key, node) if isinstance(node, dict) else ():
                node[key] = node.pop(meant)
            continue
        for near in nearest(finding["ctx"]["tag"], _tags(finding)):
            node[key] = near
    return copy


def _tag_key(finding: Mapping[str, Any]) -> str:
    """Key that says what kind of table this is."""
    return str(finding["ctx"]["discriminator"]).strip("_()'").replace("'", "")


def _tags(finding: Mapping[str, Any]) -> list[str]:
    return [tag.strip(" '") for tag in finding["ctx"]["expected_tags"].split(",")]


@contextmanager
def mistakes_in(source: str, model: type[BaseModel] | TypeAdapter[Any]) -> Iterator[None]:
    """Let what pydantic finds in a file or a value of this model be one InputError."""
    try:
        yield
    except ValidationError as error:
        raise InputError(source, mistakes_of(error, model)) from None


_schemas: dict[type[BaseModel], tuple[object, Schema]] = {}


def _schema_of(model: type[BaseModel] | TypeAdapter[Any]) -> Schema:
    """Schema of what was wanted; that of a model is made once, until a plugin changes the model."""
    if isinstance(model, TypeAdapter):
        return Schema(model.json_schema())
    core = model.__pydantic_core_schema__
    known, schema = _schemas.get(model, (None, None))
    if schema is None or known is not core:
        schema = Schema(model.model_json_schema())
        _schemas[model] = model.__pydantic_core_schema__, schema
    return schema


def nearest(name: str, names: Iterable[str], least: float = 0.6) -> list[str]:
    """Return the nearest known name, or none; ``least`` is how alike they must be, from 0 to 1."""
    return difflib.get_close_matches(name, list(names), n=1, cutoff=least)


def suggestion(name: str, names: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the nearest known name, or nothing."""
    near = nearest(name, names)
    return f"; did you mean {near[0]}?" if near else ""


def _where(finding: dict[str, Any], place: Place) -> str:
    if finding["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return f"{place.path}.{_tag_key(finding)}".lstrip(".")
    return place.path


def _mistake(where: str, findings: Sequence[dict[str, Any]], schema: Schema) -> Mistake:
    """One mistake of what pydantic found at one place: a union complains once a member."""
    first = next((f for f in findings if f["loc"] and f["loc"][-1] == "[key]"), findings[0])
    kind = first["type"]
    if kind == "extra_forbidden":
        return Mistake(where, _unknown_key(str(first["loc"][-1]), first["place"], schema))
    if kind == "union_tag_not_found":
        given = first["input"] if isinstance(first["input"], Mapping) else {}
        meant = "".join(f"; is {key} meant for it?" for key in nearest(_tag_key(first), map(str, given)))
        return Mistake(where, f"is missing{meant}")
    if kind == "missing":
        return Mistake(where, "is missing")
    if kind == "union_tag_invalid":
        context = first["ctx"]
        near = suggestion(context["tag"], _tags(first))
        return Mistake(where, f"{context['tag']!r} is not one of {context['expected_tags']}{near}")
    if kind == "json_invalid":
        return Mistake(where, f"is not JSON: {first['ctx']['error']}; is it the right file?")
    if first["loc"] and first["loc"][-1] == "[key]":
        return Mistake(where, _unknown_name(first))
    texts = list(dict.fromkeys(_text(finding) for finding in findings))
    if kind == "value_error" and len(texts) == 1:
        return Mistake(where, texts[0])
    together = " or ".join([texts[0], *(text.removeprefix("must be ") for text in texts[1:])])
    value = first.get("input")
    return Mistake(where, f"{together}{_shown(value)}{_nearest_option(value, findings)}")


def _text(finding: dict[str, Any]) -> str:
    if finding["type"] in TABLE:
        return "must be a table"
    text = str(finding["msg"])
    for pydantic, plain in PLAIN:
        text = text.replace(pydantic, plain)
    return text


def _options(finding: dict[str, Any]) -> list[str]:
    return re.findall(r"'([^']*)'", str(finding["ctx"]["expected"]))


def _nearest_option(value: Any, findings: Sequence[dict[str, Any]]) -> str:
    if not isinstance(value, str):
        return ""
    options = [o for finding in findings if finding["type"] == "literal_error" for o in _options(finding)]
    return suggestion(value, options)


def _unknown_name(finding: dict[str, Any]) -> str:
    """A table was given where each entry stands under one of some names."""
    name, options = str(finding["loc"][-2]), _options(finding)
    table = finding["place"].path.rpartition(".")[0]
    near = suggestion(name, options)
    known = near or f"; known are {', '.join(options)}"
    return f"is not a name that {table} has entries for, as in [{table}.{options[0]}]{known}"


def _unknown_key(name: str, place: Place, schema: Schema) -> str:
    """Say what a key may have been meant for: one of its own table, or the same in another one."""
    near = suggestion(name, place.names)
    table = place.path.rpartition(".")[0]
    owners = schema.owners(name)
    plain = re.sub(r"\[\d+\]", "", table)  # without the numbers of list entries
    kinds = [owner.tag for owner in owners if owner.path == plain and owner.tag]
    if kinds and place.tag:
        return f"unknown key of {place.tag}{near}" + f"; it belongs to {_listed(kinds)}" * (not near)
    if near:
        return "unknown key" + near
    places = list(dict.fromkeys(owner.path or "the top of the file" for owner in owners))
    if places:
        return f"unknown key here; it belongs to {_listed(places)}"
    return "unknown key" + _nearest_elsewhere(name, schema)


def _nearest_elsewhere(name: str, schema: Schema) -> str:
    near = nearest(name, schema.names(), ALIKE)
    if not near:
        return ""
    places = dict.fromkeys(owner.path or "the top of the file" for owner in schema.owners(near[0]))
    return f"; did you mean {near[0]}, of {_listed(list(places))}?"


def _listed(words: Sequence[str]) -> str:
    more = ", ..." if len(words) > MOST_OWNERS else ""
    return " or ".join(words[:MOST_OWNERS]) + more


def _shown(value: Any) -> str:
    if not isinstance(value, str | int | float | bool):
        return ""
    return f", not {value!r}" if len(repr(value)) < MOST_SHOWN else ""


if TYPE_CHECKING:
    from pydantic._internal._model_construction import ModelMetaclass
else:
    ModelMetaclass = type(BaseModel)


class _InPython(ModelMetaclass):
    """Values made in Python: what is wrong is one InputError. Those of a file are not made by a call."""

    def __call__(self, *given: Any, **named: Any) -> Any:
        try:
            return super().__call__(*given, **named)
        except ValidationError as error:
            raise InputError(self.__name__, mistakes_of(error, cast(type[BaseModel], self))) from None


class Strict(BaseModel, metaclass=_InPython):
    """A frozen value that refuses keys that it does not know."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def changed(self, **changes: Any) -> Self:
        """Return the same with other values of some fields, validated, unlike ``model_copy``."""
        return type(self)(**({name: getattr(self, name) for name in type(self).model_fields} | changes))


class WithInfinity(Strict):
    """Such a value whose numbers may be infinite, which JSON knows as words alone."""

    model_config = ConfigDict(ser_json_inf_nan="strings")
