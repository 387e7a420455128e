"""Options of an identification, declared once: the command line, scenarios and Python read them here."""

import itertools
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from hammerstein.plugins import load_plugins
from hammerstein.quantities import (
    DELAY_S,
    DELAY_SAMPLES,
    FREQUENCY_HZ,
    RIDGE,
    THRESHOLD_V,
    Modes,
    Operators,
    Range,
)
from hammerstein.validation import Strict, suggestion

if TYPE_CHECKING:
    from hammerstein.hysteresis.identifiable import Identifiable

Partition = Literal["auto", "time", "voltage", "fitted"]
Solver = Literal["closed_form", "least_squares", "nonnegative", "invertible"]
DynamicsKind = Literal["auto", "none", "lag", "second_order", "state_space"]
InitialStateMode = Literal["auto", "rest", "repeated"]
FEWEST_EXPERIMENTS = 3
"""Allowed numbers of experiments of a search for hysteresis in the loop."""
PLAYS = "prandtl_ishlinskii"
"""Default kind."""


def identifiable_kinds() -> dict[str, "type[Identifiable]"]:
    """Identifiable kinds of hysteresis by name, plug-ins included."""
    from hammerstein.hysteresis import HYSTERESIS
    from hammerstein.hysteresis.identifiable import Identifiable

    load_plugins()
    described = {name: file.describes for name, file in HYSTERESIS.kinds.items()}
    return {
        name: block
        for name, block in described.items()
        if block is not None and issubclass(block, Identifiable)
    }


def known_kind(name: str) -> str:
    """Return the name of an identifiable kind of hysteresis; ValueError, for pydantic, for any other name."""
    known = identifiable_kinds()
    if name not in known:
        listed = f"{', '.join(known)}{suggestion(name, known)}"
        raise ValueError(f"{name!r} is not known; choose one of {listed}")
    return name


def _plain(value: Any) -> Any:
    """Numbers and arrays of NumPy as those of Python, lists as tuples."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


def _count(value: Any) -> Any:
    """A whole number, which true and false are not."""
    if isinstance(value, bool):
        raise ValueError(f"must be a whole number, not {value!r}")
    return _plain(value)


def _thresholds(value: Any) -> Any:
    """Thresholds as tuples, from arrays, lists, or words with commas between them."""
    if isinstance(value, str):
        try:
            value = [float(word) for word in value.split(",")]
        except ValueError:
            what = "is not a list of voltages with commas between them, such as 0,0.5,1.2"
            raise ValueError(f"{value!r} {what}") from None
    value = _plain(value)
    if value is not None and not _rise(value):
        raise ValueError(f"{THRESHOLD_V.words()}, each larger than the previous one")
    return value


def _rise(value: Any) -> bool:
    """Whether every tuple of thresholds, however they are nested, holds thresholds that rise."""
    if not isinstance(value, tuple):
        return False
    if any(isinstance(part, tuple) for part in value):
        return all(map(_rise, value))
    numbers = all(isinstance(part, int | float) and THRESHOLD_V.holds(part) for part in value)
    return numbers and all(a < b for a, b in itertools.pairwise(value))


Whole = BeforeValidator(_count)
EachPair = tuple[tuple[Annotated[Operators, Whole], ...], ...]
Count = Annotated[
    Operators | EachPair | Literal["auto"],
    Whole,
    Field(description="play operators of each pair of axes, fitted ones at most; auto: by cross-validation"),
]
Placed = Annotated[
    Partition,
    Field(description="thresholds: uniform in time or voltage, fitted, or auto: fitted if better"),
]
Kind = Annotated[
    str,
    AfterValidator(known_kind),
    Field(description="hysteresis: prandtl_ishlinskii (plays), asymmetric, generalised and others"),
]
DeadZones = Annotated[
    Annotated[int, Range(0, 50)] | None,
    Whole,
    Field(description="dead-zones of each input, with asymmetric; searched if omitted"),
]
LinearBlock = Annotated[
    DynamicsKind,
    Field(description="dynamics: none, lag, second_order (a resonance), state_space, or auto: lowest error"),
]
MOST_STATES = 400
"""Largest order; the largest model of measured records has 48 states."""
Order = Annotated[
    Annotated[int, Range(1, MOST_STATES)] | None,
    Whole,
    Field(description="states of a state-space model, of all axes together; searched if omitted"),
]


class KindOptions(Strict):
    """Kind of hysteresis."""

    hysteresis: Kind = PLAYS
    dead_zones: DeadZones = None


class KnownSensor(Strict):
    """What is known of the sensor and the columns of the records."""

    sensor_bandwidth_hz: Annotated[
        Annotated[float, FREQUENCY_HZ] | None,
        Field(description="first-order bandwidth of the sensor, from its data sheet; unlimited if omitted"),
    ] = None
    sensor_delay_s: Annotated[
        float, DELAY_S, Field(description="known delay of the sensor; excluded from the model")
    ] = 0.0
    accept_order: Annotated[bool, Field(description="accept the columns although an output leads")] = False


class CascadeOptions(KnownSensor):
    """Options of an identification with any kind of hysteresis."""

    operators: Count = "auto"
    partition: Placed = "auto"
    thresholds_v: Annotated[
        Any, BeforeValidator(_thresholds), Field(description="your own thresholds in V, for all pairs")
    ] = None
    solver: Annotated[
        Solver, Field(description="weights: invertible, least_squares, nonnegative or closed_form")
    ] = "invertible"
    ridge: Annotated[float, RIDGE, Field(description="ridge penalty of the weights; 0: none")] = 0.0
    dynamics: LinearBlock = "auto"
    order: Order = None
    creep_modes: Annotated[
        Modes | Literal["auto"],
        Whole,
        Field(description="slow modes of each axis; auto: up to 3, each if it lowers the error"),
    ] = "auto"
    delay_samples: Annotated[
        Annotated[int, DELAY_SAMPLES] | None,
        Whole,
        Field(description="delay of the outputs beside the sensor's; estimated if omitted"),
    ] = None
    start: Annotated[
        InitialStateMode,
        Field(description="how each record begins: auto, rest (never driven), or repeated (as it ends)"),
    ] = "auto"
