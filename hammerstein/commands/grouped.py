"""Options that several commands have, as one value: the fields of a dataclass become options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter
from typing import Any, get_type_hints

from typer.models import ArgumentInfo


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command an option for each field of its parameters that are dataclasses.

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


def words_of(group: Any) -> list[str]:
    """Words of a command line that give a group as it is: arguments, and options that are not their defaults.

    >>> from hammerstein.commands.record_options import RecordFiles
    >>> words_of(RecordFiles(["a.csv", "b.csv"], rate=5e3, accept_gain=True))
    ['a.csv', 'b.csv', '--rate', '5000.0', '--accept-gain']
    """
    hints, words = get_type_hints(type(group), include_extras=True), list[str]()
    for field in fields(group):
        value, (info, *_) = getattr(group, field.name), hints[field.name].__metadata__
        values = value if isinstance(value, list | tuple) else [value]
        if isinstance(info, ArgumentInfo):
            words += map(str, values)
        elif value != field.default:
            name = (info.param_decls or [f"--{field.name.replace('_', '-')}"])[0]
            words += [name] if value is True else [word for one in values for word in (name, str(one))]
    return words


def _options(group: Any) -> Iterator[Parameter]:
    hints = get_type_hints(group, include_extras=True)
    for field in fields(group):
        default = Parameter.empty if field.default is MISSING else field.default
        yield Parameter(field.name, Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name])
