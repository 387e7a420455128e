"""From pydantic's findings to mistakes that a person can mend."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Any

from pydantic import BaseModel, ValidationError

from hammerstein.errors import Mistake


def mistakes_of(error: ValidationError, model: type[BaseModel]) -> list[Mistake]:
    """Every finding with its key path, what is wrong and the nearest known name."""
    names = sorted(set(_names(model.model_json_schema())))
    found: dict[str, Mistake] = {}
    for finding in error.errors():
        mistake = _mistake(dict(finding), names)
        found.setdefault(mistake.where or mistake.what, mistake)  # a union complains once a member
    return list(found.values())


def _mistake(finding: dict[str, Any], names: list[str]) -> Mistake:
    kind, message = finding["type"], finding["msg"]
    where = _path(finding["loc"], names)
    if kind == "extra_forbidden":
        return Mistake(where, "unknown key" + suggestion(str(finding["loc"][-1]), names))
    if kind == "missing":
        return Mistake(where, "is missing")
    if kind == "union_tag_invalid":
        context = finding["ctx"]
        tags = context["expected_tags"]
        near = suggestion(context["tag"], [t.strip(" '") for t in tags.split(",")])
        return Mistake(
            f"{where}.{context['discriminator'].strip('_()')}".replace("'", "").lstrip("."),
            f"{context['tag']!r} is not one of {tags}{near}",
        )
    if kind == "union_tag_not_found":
        return Mistake(
            f"{where}.{finding['ctx']['discriminator']}".replace("'", "").lstrip("."), "is missing"
        )
    if kind == "json_invalid":
        return Mistake(where or "line", f"is not JSON: {finding['ctx']['error']}")
    text = message.removeprefix("Value error, ").replace("Input should be", "must be")
    shown = _shown(finding.get("input"))
    if kind == "literal_error" and isinstance(finding.get("input"), str):
        options = [o.strip(" '") for o in finding["ctx"]["expected"].replace(" or ", ", ").split(",")]
        return Mistake(where, f"{text}{shown}{suggestion(finding['input'], options)}")
    return Mistake(where, f"{text}{shown if kind != 'value_error' else ''}")


def _path(location: tuple[Any, ...], names: list[str]) -> str:
    """Key path without the tags that pydantic inserts for unions; list entries count from 1."""
    path = ""
    for i, part in enumerate(location):
        if isinstance(part, int):
            path += f"[{part + 1}]"
        elif part in names or (i == len(location) - 1 and part.isidentifier()):
            path += f".{part}" if path else str(part)
    return path


def _shown(value: Any) -> str:
    return f", not {value!r}" if isinstance(value, (str, int, float, bool)) and len(repr(value)) < 60 else ""


def suggestion(name: str, names: list[str]) -> str:
    """Give "; did you mean ...?" with the nearest known name, or nothing."""
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    return f"; did you mean {near[0]}?" if near else ""


def _names(schema: Any) -> Iterator[str]:
    """All property names of a JSON schema."""
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for value in schema.values():
            yield from _names(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from _names(value)
