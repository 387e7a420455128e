"""Kinds that plug in: signals, compensators and every other value that a file names by its kind.

A family is what a scenario or model file chooses from by a tag, such as ``kind = "circle"``. The package's
own kinds and those of others are registered in the same way, and nothing else knows their names. Others,
and what the package has for one paper alone, are found by the entry point group ``hammerstein.blocks``: each
entry is a class, or a module that calls ``register``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Annotated, Any, Generic, TypeVar, get_args

from pydantic import BaseModel, GetCoreSchemaHandler, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, core_schema

from hammerstein.errors import InputError

GROUP = "hammerstein.blocks"

T = TypeVar("T", bound=BaseModel)
V = TypeVar("V")
K = TypeVar("K", bound=type[BaseModel])


class Family(Generic[T]):
    """The kinds of one family, by their tag.

    Parameters
    ----------
    base : what every kind of the family is a subclass of
    tag : field that names the kind; in each kind a ``Literal`` of one name
    """

    def __init__(self, base: type[T], tag: str):
        self.base, self.tag = base, tag
        self.kinds: dict[str, type[T]] = {}
        self._users: list[type[BaseModel]] = []
        _FAMILIES.append(self)

    def register(self, kind: type[T]) -> None:
        """Add a kind; InputError where its name is taken or not stated."""
        field = kind.model_fields.get(self.tag)
        names = get_args(field.annotation) if field is not None else ()
        if len(names) != 1 or not isinstance(names[0], str):
            raise InputError(kind.__name__, f'names no kind: give it a field {self.tag}: Literal["..."]')
        if names[0] in self.kinds and self.kinds[names[0]] is not kind:
            raise InputError(kind.__name__, f"{self.tag} = {names[0]!r} is taken")
        self.kinds[names[0]] = kind
        for user in self._users:
            user.model_rebuild(force=True)

    def remove(self, kind: type[T]) -> None:
        """Forget a kind again, as tests do."""
        self.kinds = {name: known for name, known in self.kinds.items() if known is not kind}
        for user in self._users:
            user.model_rebuild(force=True)

    def used_by(self, model: type[BaseModel]) -> None:
        """Note a model that has a field of this family: it follows when a kind is added."""
        self._users.append(model)

    def adapter(self) -> TypeAdapter[T]:
        """What validates one of the kinds, chosen by its tag, from plain data."""
        return TypeAdapter(Annotated[self.base, self.field()])  # type: ignore[arg-type]

    def value(self, data: Any) -> T:
        """One of the kinds from plain data; ValidationError where it is wrong."""
        return looked_up(lambda: self.adapter().validate_python(data))

    def field(self, form: Callable[[type[T]], type[BaseModel]] = lambda kind: kind) -> Choice:
        """Annotation of a field that holds one of the kinds, in the form that the field wants."""
        return Choice(self, form)


class Choice:
    """Annotation of a field that holds one kind of a family, chosen by its tag."""

    def __init__(self, family: Family[Any], form: Callable[[Any], type[BaseModel]]):
        self.family, self.form = family, form

    def __get_pydantic_core_schema__(self, source: object, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Choose by the tag among the kinds that are known now."""
        choices = {name: handler.generate_schema(self.form(kind)) for name, kind in self.family.kinds.items()}
        choices = choices or {"none": core_schema.none_schema()}  # as long as no kind has plugged in
        return core_schema.tagged_union_schema(choices, discriminator=self.family.tag)


_FAMILIES: list[Family[Any]] = []


def register(kind: K) -> K:
    """Register a kind of signal, compensator, hysteresis, dynamics or assessment, so that files can name it.

    Usable as a decorator.

    Raises
    ------
    InputError : it belongs to no family, or its name is taken
    """
    for family in _FAMILIES:
        if issubclass(kind, family.base):
            family.register(kind)
            return kind
    bases = ", ".join(family.base.__name__ for family in _FAMILIES)
    raise InputError(kind.__name__, f"is not a kind that can be registered; derive it from one of {bases}")


def looked_up(validate: Callable[[], V]) -> V:
    """What a validation gives; where it meets a name that nobody knows, once more with the plug-ins loaded.

    Parameters
    ----------
    validate : asks the model anew each time, which is built again when a kind plugs in

    Raises
    ------
    ValidationError : as the validation raises it
    """
    try:
        return validate()
    except ValidationError as error:
        if not any(found["type"] == "union_tag_invalid" for found in error.errors(include_url=False)):
            raise
    load_plugins()
    return validate()


def kinds_of_others() -> tuple[type[BaseModel], ...]:
    """Kinds that are registered now and are not of this package."""
    own = __name__.partition(".")[0] + "."
    return tuple(
        kind for family in _FAMILIES for kind in family.kinds.values() if not kind.__module__.startswith(own)
    )


@cache
def load_plugins() -> None:
    """Import what other packages offer in the entry point group, once."""
    for entry in entry_points(group=GROUP):
        found = entry.load()
        if isinstance(found, type):
            register(found)
