"""Numbers in files and options: finite, and within physical limits.

One place for all of them: the scenario, the signals, the compensators, the instruments, the dynamics, the
model file and the settings of an identification. The limits are wide; they keep out what no actuator is, and
what would overflow further on. The unit of a number is in its name.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any, TypeVar

from pydantic import AfterValidator, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, JsonValue
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from hammerstein.escaping import clean

OUT_OF_RANGE = "out_of_range"
T = TypeVar("T")
K = TypeVar("K")


@dataclass(frozen=True)
class Range:
    """Numbers from ``low`` to ``high``, ends included; ``or_inf`` and ``or_zero`` allow what switches off.

    >>> Range(0.0, 10.0).words(), Range(1.0, 10.0, or_zero=True).words()
    ('must be 0 to 10', 'must be 0, or 1 to 10')
    """

    low: float
    high: float
    or_inf: bool = False
    or_zero: bool = False

    def holds(self, value: float) -> bool:
        """Whether a number lies within; NaN never does."""
        switched_off = self.or_inf and (value == math.inf or (self.low < 0.0 and value == -math.inf))
        switched_off |= self.or_zero and value == 0.0
        return switched_off or self.low <= value <= self.high

    def words(self) -> str:
        """Say what is allowed."""
        zero, inf = "0, or " * self.or_zero, " or inf" * self.or_inf
        return f"must be {zero}{_plain(self.low)} to {_plain(self.high)}{inf}"

    def checked(self, value: Any) -> Any:
        """Return the value back, or say what is allowed."""
        if not self.holds(value):
            raise PydanticCustomError(OUT_OF_RANGE, "{words}", {"words": self.words()})
        return value

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self.checked, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        limits: dict[str, Any] = {}
        if not (self.or_inf and self.low < 0.0):
            limits["minimum"] = 0.0 if self.or_zero else self.low
        if not self.or_inf:
            limits["maximum"] = self.high
        return handler(schema) | limits


def _plain(number: float) -> str:
    """A limit as a person writes it.

    >>> _plain(1e-06), _plain(200), _plain(2**53)
    ('1e-6', '200', '9007199254740992')
    """
    if isinstance(number, int) and number % 10:
        return str(number)
    if number == 0.0 or 1e-3 <= abs(number) < 1e6:
        return f"{number:g}"
    return f"{number:.0e}".replace("e-0", "e-").replace("e+0", "e").replace("e+", "e")


POSITION_UM = Range(-1e9, 1e9)  # a kilometre: no wire of a simulation goes there
VOLTAGE_V = Range(-1e6, 1e6)
END_V = Range(-1e6, 1e6, or_inf=True)  # of a drive's range
BANDWIDTH_HZ = Range(1e-6, 1e9, or_inf=True)
FREQUENCY_HZ = Range(1e-6, 1e8)
SCALE = Range(-1e12, 1e12)
THRESHOLD_V = Range(0.0, 1e6)
DELAY_SAMPLES = Range(0, 10**6)
DELAY_S = Range(0.0, 1e4)
RATE_HZ = Range(1e-4, 1e9)
RIDGE = Range(0.0, 1e12)
TIME_CONSTANT_S = Range(1e-9, 1e10)
RESONANCE_HZ = Range(1e-6, 1e9)

# Of signals, drive and sensor
Size = Annotated[float, Range(1e-6, 1e6)]  # in V or um, as the name says
Offset = Annotated[float, Range(-1e6, 1e6)]
Phase = Annotated[float, Range(-1e6, 1e6)]
Frequency = Annotated[float, FREQUENCY_HZ]
Bandwidth = Annotated[float, BANDWIDTH_HZ]
Limit = Annotated[float, Range(1e-6, 1e6, or_inf=True)]  # of a drive or a sensor; inf: none
End = Annotated[float, END_V]
Step = Annotated[float, Range(1e-12, 1e6, or_zero=True)]  # of a converter; 0: none
Noise = Annotated[float, Range(0.0, 1e6)]  # its rms; 0: none
SampleTime = Annotated[float, Range(1e-9, 1e4)]
Scale = Annotated[float, SCALE]

# Times
Wait = Annotated[float, Range(1e-9, 1e8, or_zero=True)]
Length = Annotated[float, Range(1e-6, 1e8)]
Delay = Annotated[float, DELAY_S]
TimeConstant = Annotated[float, TIME_CONSTANT_S]

# Of models
Volts = Annotated[float, Range(0.0, 1e6)]
Threshold = Annotated[float, THRESHOLD_V]
Weight = Annotated[float, Range(-1e9, 1e9)]
WeightError = Annotated[float, Range(0.0, 1e9)]
Resonance = Annotated[float, RESONANCE_HZ]
Damping = Annotated[float, Range(1e-6, 1e4)]
PerVolt = Annotated[float, Range(-1e6, 1e6)]
CreepGain = Annotated[float, Range(-1e3, 1e3)]
Entry = Annotated[float, Range(-1e20, 1e20)]  # of a matrix of a linear block
Gain = Annotated[float, Range(-1e9, 1e9)]

# Of comparisons
Deviation = Annotated[float, Range(0.0, 1.0)]  # relative standard deviation of a parameter
Tolerated = Annotated[float, Range(0.0, 1e12)]
Figure = Annotated[float, Range(-1e12, 1e12)]
Agreed = Annotated[float, Range(1e-12, 1e12)]

# Counts
Seed = Annotated[int, Range(0, 2**53)]  # as large as JSON keeps whole numbers
Cycles = Annotated[int, Range(1, 10**9)]
NoCycles = Annotated[int, Range(0, 10**9)]
Draws = Annotated[int, Range(1, 10**9)]
BaseSamples = Annotated[int, Range(8, 2**24)]
Trial = Annotated[int, Range(1, 1000)]  # the first one is without learning
Passes = Annotated[int, Range(1, 10**7)]
Operators = Annotated[int, Range(1, 200)]
Axes = Annotated[int, Range(1, 100)]
InputNumber = Annotated[int, Range(1, 100)]  # counted from 1
Modes = Annotated[int, Range(0, 5)]


def _without_control_characters(text: str) -> str:
    if not text.isprintable():
        raise ValueError("contains a character that cannot be printed; type it again")
    return text


LONGEST_NAME = 100
"""Characters of a name that fits a table."""


def no_name(text: str) -> str:
    """Say why a text is no name of a model or an axis; empty if it is one.

    >>> no_name("stage x"), no_name("")
    ('', 'is empty; give it a name')
    """
    if not text:
        return "is empty; give it a name"
    if len(text) > LONGEST_NAME:
        return f"has {len(text)} characters; a name has at most {LONGEST_NAME}"
    if not text.isprintable():
        return "contains a character that cannot be printed; type it again"
    return ""


def _finite_throughout(value: JsonValue) -> JsonValue:
    try:
        json.dumps(value, allow_nan=False)
    except ValueError:
        raise ValueError("contains a number that is not finite; JSON has none") from None
    return value


def of_equal_rows(matrix: Any) -> Any:
    """Refuse a matrix whose rows differ in length; words in its place pass."""
    if not isinstance(matrix, str) and len({len(row) for row in matrix}) != 1:
        raise ValueError("has rows of different lengths, or none; give a matrix")
    return matrix


# Words
FileName = Annotated[str, Field(max_length=4000), AfterValidator(_without_control_characters)]
Name = Annotated[
    str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_without_control_characters)
]
Plain = Annotated[JsonValue, AfterValidator(_finite_throughout)]


def length(um: float, digits: int = 3) -> str:
    """Position or error in um, without an exponent; below 10 pm it is rounding.

    >>> length(0.0123456), length(-4.5e-12), length(1.2e-5)
    ('0.0123', '0', '0.00001')
    """
    return f"{Decimal(f'{round(um, 5):z.{digits}g}'):f}"


def interval(seconds: float) -> str:
    """Sample time or delay, in the unit that engineers give it in.

    >>> interval(5e-5), interval(0.00325), interval(1.5), interval(1e-3 - 1e-12)
    ('50 us', '3.25 ms', '1.5 s', '1 ms')
    """
    seconds = float(f"{seconds:.4g}")
    factor, unit = ((1.0, "s"), (1e3, "ms"), (1e6, "us"))[(seconds < 1.0) + (seconds < 1e-3)]
    return f"{factor * seconds:.4g} {unit}"


def number_of(count: int, word: str) -> str:
    """How many of something there are.

    >>> number_of(1, "input"), number_of(2, "input"), number_of(0, "sample")
    ('1 input', '2 inputs', '0 samples')
    """
    return f"{count} {word}{'s' * (count != 1)}"


def sampling(sample_time_s: float | None) -> str:
    """Grid of a block in words; without a sample time it is continuous.

    >>> sampling(5e-5), sampling(None)
    ('with a sample time of 50 us', 'continuous')
    """
    return f"with a sample time of {interval(sample_time_s)}" if sample_time_s else "continuous"


def size(number: float) -> str:
    """Bytes in words.

    >>> size(2.4e9), size(3e13)
    ('2.4 GB', '30,000 GB')
    """
    return f"{number / 1e9:,.3g} GB" if number < 1e12 else f"{number / 1e9:,.0f} GB"


def duration(seconds: float) -> str:
    """Time in words.

    >>> duration(900.0), duration(9000.0), duration(1e6)
    ('15 minutes', '2.5 hours', '12 days')
    """
    for unit, span in (("days", 86400.0), ("hours", 3600.0)):
        if seconds >= 2.0 * span:
            number = seconds / span
            return f"{number:.2g} {unit}" if number < 99 else f"{number:,.0f} {unit}"
    return f"{seconds / 60.0:.0f} minutes" if seconds >= 90.0 else f"{seconds:.2g} seconds"


def unique(names: Sequence[str], written: Callable[[str], str] = str) -> tuple[str, ...]:
    """Unique names: the second ``Volt`` becomes ``Volt_2``.

    Parameters
    ----------
    names : in their order
    written : form of a name in a file; two names must not have the same form

    Examples
    --------
    >>> unique(["Volt", "Volt", "Volt_2"])
    ('Volt', 'Volt_3', 'Volt_2')
    >>> unique(["stage x", "stage_x"], word)
    ('stage x', 'stage_x_2')
    """
    found: list[str] = []
    for i, name in enumerate(names):
        number, chosen = 2, name
        before, behind = set(map(written, found)), set(map(written, names[i + 1 :]))
        while written(chosen) in before or (chosen != name and written(chosen) in behind):
            chosen, number = f"{name}_{number}", number + 1
        found.append(chosen)
    return tuple(found)


def word(axis: str) -> str:
    """Name of an axis within that of a column: nothing in it ends a cell or opens a comment.

    >>> word("stage X, #2")
    'stage_X_2'
    """
    return "_".join(clean(axis).replace("#", " ").replace(",", " ").split())


def column(quantity: str, axis: str, unit: str) -> str:
    """Name of the column of an axis in a file of ours.

    >>> column("drive", "x", "v"), column("position", "stage X, #2", "um")
    ('drive_x_v', 'position_stage_X_2_um')
    """
    return f"{quantity}_{word(axis)}_{unit}"


def by_key(items: Iterable[T], key: Callable[[T], K]) -> dict[K, list[T]]:
    """Items of every key, in their order.

    >>> by_key(["a1", "b1", "a2"], lambda name: name[0])
    {'a': ['a1', 'a2'], 'b': ['b1']}
    """
    found: dict[K, list[T]] = {}
    for item in items:
        found.setdefault(key(item), []).append(item)
    return found


LEAST_SHARE = 1e-6  # smaller ones are rounding errors


def percent(share: float) -> str:
    """Text of a fraction in percent with two significant digits, without exponent.

    >>> percent(0.0378), percent(0.996), percent(1.024), percent(1e-16)
    ('3.8 %', '100 %', '102 %', '< 0.0001 %')
    """
    if 0.0 < abs(share) < LEAST_SHARE:
        return "< 0.0001 %"
    return f"{100.0 * share:.{'2g' if abs(share) < 0.995 else '0f'}} %"
