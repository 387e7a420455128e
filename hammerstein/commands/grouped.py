"""Options that several commands have, as one value: the fields of a dataclass become options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter
from typing import Any, get_type_hints


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command an option for each field of its parameters that are dataclasses.

    >>> from dataclasses import dataclass
    >>> @dataclass
    ... class Place:
    ...     x: float
    ...     y: float = 0.0
    >>> @grouped
    ... def show(place: Place, loud: bool = False) -> None:
    ...     print(place, loud)
    >>> str(inspect.signature(show))
    '(*, x: float, y: float = 0.0, loud: bool = False)'
    >>> show(x=1.0)
    Place(x=1.0, y=0.0) False
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {
        name: hints[name] for name in inspect.signature(command).parameters if is_dataclass(hints[name])
    }
    flat: list[Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        own = Parameter(name, Parameter.KEYWORD_ONLY, default=parameter.default, annotation=hints[name])
        flat += _options(groups[name]) if name in groups else [own]

    @wraps(command)
    def run(**options: Any) -> None:
        for name, group in groups.items():
            held = {field.name: options.pop(field.name) for field in fields(group) if field.name in options}
            options[name] = group(**held)
        command(**options)

    run.__signature__ = inspect.Signature(flat)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    return run


def _options(group: Any) -> Iterator[Parameter]:
    hints = get_type_hints(group, include_extras=True)
    for field in fields(group):
        default = Parameter.empty if field.default is MISSING else field.default
        yield Parameter(field.name, Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name])
