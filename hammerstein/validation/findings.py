"""From pydantic's findings to mistakes that a person can mend."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from typing import Any

from pydantic import BaseModel, TypeAdapter, ValidationError

from hammerstein.errors import Mistake
from hammerstein.validation.schema_places import Place, Schema

MOST_SHOWN = 60  # characters of a value
MOST_OWNERS = 3
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
        place = schema.place(_without_mark(finding["loc"]))
        found.setdefault(_where(dict(finding), place), []).append({**finding, "place": place})
    return [_mistake(where, findings, schema) for where, findings in found.items()]


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


def suggestion(name: str, names: Iterable[str]) -> str:
    """Give "; did you mean ...?" with the nearest known name, or nothing."""
    near = difflib.get_close_matches(name, list(names), n=1, cutoff=0.6)
    return f"; did you mean {near[0]}?" if near else ""


def _without_mark(location: tuple[str | int, ...]) -> tuple[str | int, ...]:
    """Location of the key itself, where pydantic marks that the key is wrong and not its value."""
    return location[:-1] if location and location[-1] == "[key]" else location


def _where(finding: dict[str, Any], place: Place) -> str:
    if finding["type"] in ("union_tag_invalid", "union_tag_not_found"):
        tag = finding["ctx"]["discriminator"].strip("_()'").replace("'", "")
        return f"{place.path}.{tag}".lstrip(".")
    return place.path


def _mistake(where: str, findings: Sequence[dict[str, Any]], schema: Schema) -> Mistake:
    """One mistake of what pydantic found at one place: a union complains once a member."""
    first = next((f for f in findings if f["loc"] and f["loc"][-1] == "[key]"), findings[0])
    kind = first["type"]
    if kind == "extra_forbidden":
        return Mistake(where, _unknown_key(str(first["loc"][-1]), first["place"], schema))
    if kind == "missing":
        return Mistake(where, "is missing")
    if kind == "union_tag_invalid":
        context = first["ctx"]
        near = suggestion(context["tag"], [t.strip(" '") for t in context["expected_tags"].split(",")])
        return Mistake(where, f"{context['tag']!r} is not one of {context['expected_tags']}{near}")
    if kind == "union_tag_not_found":
        return Mistake(where, "is missing")
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
    return f"is no name that {table} has entries for, as in [{table}.{options[0]}]{known}"


def _unknown_key(name: str, place: Place, schema: Schema) -> str:
    """Say what a key may have been meant for: one of its own table, or the same in another one."""
    near = suggestion(name, place.names)
    table = place.path.rpartition(".")[0]
    owners = schema.owners(name)
    kinds = [owner.tag for owner in owners if owner.path == _plain(table) and owner.tag]
    if kinds and place.tag:
        return f"unknown key of {place.tag}{near}" + f"; it belongs to {_listed(kinds)}" * (not near)
    if near:
        return "unknown key" + near
    places = list(dict.fromkeys(owner.path or "the top of the file" for owner in owners))
    if places:
        return f"unknown key here; it belongs to {_listed(places)}"
    return "unknown key" + _nearest_elsewhere(name, schema)


def _nearest_elsewhere(name: str, schema: Schema) -> str:
    near = difflib.get_close_matches(name, schema.names(), n=1, cutoff=0.6)
    if not near:
        return ""
    places = dict.fromkeys(owner.path or "the top of the file" for owner in schema.owners(near[0]))
    return f"; did you mean {near[0]}, of {_listed(list(places))}?"


def _listed(words: Sequence[str]) -> str:
    more = ", ..." if len(words) > MOST_OWNERS else ""
    return " or ".join(words[:MOST_OWNERS]) + more


def _plain(path: str) -> str:
    """Key path without the numbers of list entries."""
    return re.sub(r"\[\d+\]", "", path)


def _shown(value: Any) -> str:
    if not isinstance(value, str | int | float | bool):
        return ""
    return f", not {value!r}" if len(repr(value)) < MOST_SHOWN else ""
