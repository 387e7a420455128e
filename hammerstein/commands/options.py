"""Options of several commands, and errors in terms of these options."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import field, is_dataclass
from functools import wraps
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO, get_args, get_type_hints

import typer
from typer.models import ArgumentInfo

from hammerstein.commands.terminal import tell_kept
from hammerstein.errors import InputError

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from hammerstein.runtime.staging import Owner

Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace existing files, also edited ones.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")]

_ALONE = ("start", "range", "axes")
"""Options with messages of their own."""
_OPTIONS = {
    "sample_time_s": "sample-time",
    "range_v": "range",
    "start_v": "start",
    "offset_um": "offset",
    "approach_um": "approach-side",
    "sensor_bandwidth_hz": "sensor-bandwidth",
    "sensor_delay_s": "sensor-delay",
    "thresholds_v": "thresholds",
}
METAVARS = {"_hz": "HZ", "_s": "SECONDS", "_v": "V[,V]"}
"""Value of an option in the help, by the unit of its field."""


def refuse_output(out: Path, inputs: list[Path], owner: Owner, overwrite: bool) -> None:
    """Refuse an output that cannot be written, belongs to somebody, or is one of the inputs."""
    from hammerstein.runtime.staging import prepare_file

    if any(path.resolve() == out.resolve() for path in inputs):
        raise InputError("--out", f"{out} is one of the input files; choose another name")
    prepare_file("--out", out, owner, overwrite)


def write_output(out: Path, content: str | BinaryIO, owner: Owner, overwrite: bool) -> None:
    """Write one file; state the new place of a file that a person had changed."""
    from hammerstein.runtime.staging import write_file

    tell_kept(write_file(out, content, owner, overwrite))


def with_help(help_: str, name: str = "", default: Any = None, **settings: Any) -> Any:
    """Parameter of a command, or field of a dataclass of options: an option with this help.

    name : if not that of the parameter; settings : see ``typer.Option``
    """
    info = typer.Option(help=help_, **settings)
    info.param_decls = (name,) if name else ()
    return field(default=default, metadata={"option": info})


@contextmanager
def told_by_options(source: str, own: Collection[str] = ()) -> Iterator[None]:
    """Name the command's options in errors about arguments of a function.

    own : keys that were given as ``--option KEY=VALUE``
    """
    try:
        yield
    except InputError as error:
        if error.source in _ALONE:
            raise InputError(f"--{error.source}", error.mistakes) from None
        if error.source != source:
            raise
        named = [  # lists are for Python and scenarios alone
            m._replace(where=option_of(m.where, own), what=m.what.replace(" or a list", ""))
            for m in error.mistakes
        ]
        raise InputError("options", named) from None


def option_of(where: str, own: Collection[str] = ()) -> str:
    """Option that gave a setting; nothing where the mistake is of them together."""
    name = where.partition("[")[0]
    if name.partition(".")[0] in own:
        return f"--option {where}"
    return f"--{_OPTIONS.get(name, name.replace('_', '-'))}" * bool(name)


def grouped(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with an option for each field of its parameters that are dataclasses or models.

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
    flat, groups = list[Parameter](), dict[str, tuple[Any, list[Parameter]]]()
    for one in _options(command):
        if is_dataclass(one.annotation) or hasattr(one.annotation, "model_fields"):
            groups[one.name] = one.annotation, _options(one.annotation)
        flat += groups[one.name][1] if one.name in groups else [one]

    @wraps(command)
    def run(**options: Any) -> None:
        for name, (group, own) in groups.items():
            held = {one.name: options.pop(one.name) for one in own if one.name in options}
            with told_by_options(group.__name__):
                options[name] = group(**held)
        command(**options)

    run.__signature__ = inspect.Signature(flat)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in flat}
    return run


def words_of(group: Any) -> list[str]:
    """Command line of a group: arguments, and options that differ from their defaults.

    >>> from hammerstein.commands.records import RecordFiles
    >>> words_of(RecordFiles(["a.csv", "b.csv"], rate=5e3, accept_gain=True))
    ['a.csv', 'b.csv', '--rate', '5000', '--accept-gain']
    """
    words = list[str]()
    for option in _options(type(group)):
        value, (info, *_) = getattr(group, option.name), option.annotation.__metadata__
        values = value if isinstance(value, list | tuple) else [value]
        plain = [str(one).removesuffix(".0") if isinstance(one, float) else str(one) for one in values]
        plain = [",".join(plain)] if isinstance(value, tuple) else plain
        if isinstance(info, ArgumentInfo):
            words += plain
        elif value != option.default:
            name = option_of(option.name)
            words += [name] if value is True else [word for one in plain for word in (name, one)]
    return words


def _option(name: str, field: FieldInfo) -> Parameter:
    """Field of a model as an option; numbers or words are told apart by its validation."""
    told = str(field.description)
    unit = next((unit for ending, unit in METAVARS.items() if name.endswith(ending)), None)
    members = {getattr(one, "__origin__", one) for one in get_args(field.annotation) or (field.annotation,)}
    kind = next((one for one in (bool, int, float) if members <= {one, type(None)}), str)
    info = typer.Option(option_of(name), metavar=unit, help=f"{told[0].upper()}{told[1:]}.")
    wanted = kind | None if field.default is None else kind
    annotation = Annotated[wanted, info]  # type: ignore[valid-type]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=field.default, annotation=annotation)


def _options(taker: Callable[..., Any]) -> list[Parameter]:
    """Parameters of a command, or fields of a group, as options."""
    if hasattr(taker, "model_fields"):
        return [_option(name, field) for name, field in taker.model_fields.items()]
    try:
        hints = get_type_hints(taker, include_extras=True)
    except NameError:  # a model of options, which a command that is not called does not import
        from hammerstein.identification import options

        hints = get_type_hints(taker, localns=vars(options), include_extras=True)
    each = inspect.signature(taker).parameters
    told = getattr(taker, "__dataclass_fields__", None) or {one.name: one.default for one in each.values()}
    found = []
    for name, one in each.items():
        hint, default = hints[name], one.default
        if info := getattr(told[name], "metadata", {}).get("option"):
            hint, default = Annotated[hint, info], told[name].default
            if default is not True and not info.param_decls:
                info.param_decls = (option_of(name),)  # what is on has a --no- beside it
        found.append(one.replace(kind=Parameter.KEYWORD_ONLY, annotation=hint, default=default))
    return found
