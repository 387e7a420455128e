"""Claims of a publication: statement, printed figure, and rows of a run to compare it with."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hammerstein.metrics import KEY, Row
from hammerstein.quantities import Agreed, Figure, Frequency, Size, Trial
from hammerstein.scenario.assessment import MetricName
from hammerstein.validation import Strict

_REDUCE: dict[str, Callable[[Sequence[float]], float]] = {
    "max": max,
    "min": min,
    "mean": lambda values: float(np.mean(values)),
    "spread": lambda values: max(values) / min(values) if min(values) else math.nan,
}


FactorName = Literal[
    "sensor", "dynamics", "passes", "sample_time", "identification_amplitude", "identification_frequency"
]
"""Part of the simulated chain that can be changed alone to find a cause."""


SIDES: dict[str, float] = {"octaves_below": -1.0, "octaves_above": 1.0}
"""Direction of octaves from the identification frequency."""


class Quantity(Strict):
    """A number computed from rows of a report.

    ``metric`` of the selected rows, reduced by ``of``: ``spread`` is the largest over the smallest;
    ``octaves_below`` and ``octaves_above`` count the octaves from ``found_hz`` to where the metric first
    exceeds ``times`` its value at ``found_hz``. A sweep that ends before that gives no number.
    """

    metric: MetricName = Field(description="figure of merit, a column of the report")
    compensator: str | None = Field(default=None, description="label of the rows")
    excited_axis: str | None = Field(default=None, description="driven axis of the rows")
    measured_axis: str | None = Field(default=None, description="measured axis of the rows")
    frequency_hz: Frequency | None = Field(default=None, description="frequency of the rows")
    from_hz: Frequency | None = Field(default=None, description="lowest frequency of the rows")
    to_hz: Frequency | None = Field(default=None, description="highest frequency of the rows")
    amplitude_v: Size | None = Field(default=None, description="amplitude of the drive of the rows")
    amplitude_um: Size | None = Field(default=None, description="amplitude of the reference of the rows")
    trial: Trial | None = Field(default=None, description="trial of the rows")
    of: Literal["max", "min", "mean", "spread", "octaves_below", "octaves_above"] = Field(
        default="max", description="reduction of the rows to one number"
    )
    found_hz: Frequency | None = Field(default=None, description="frequency from which octaves are counted")
    times: Agreed = Field(
        default=2.0,
        description="limit of the figure, relative to its value at found_hz, that ends the octaves",
    )

    @model_validator(mode="after")
    def _counts_octaves_from_somewhere(self) -> Self:
        if (self.of in SIDES) != (self.found_hz is not None):
            raise ValueError("octaves_below and octaves_above need found_hz, from which they are counted")
        return self

    def value(self, rows: Iterable[Row]) -> float:
        """The number; NaN where no row is selected."""
        known = self.known(rows)
        if self.found_hz is None:
            return self.reduced([value for _, value in known])
        return held([(self._octaves(row), v) for row, v in known], self.times)

    def covers(self, rows: Iterable[Row], octaves: float) -> bool:
        """Whether the sweep goes so many octaves from ``found_hz``; never, if octaves are not counted."""
        known = self.known(rows) if self.found_hz is not None else []
        return any(self._octaves(row) >= octaves for row, _ in known)

    def _octaves(self, row: Row) -> float:
        """Octaves of a row from ``found_hz``."""
        assert self.found_hz is not None
        return SIDES[self.of] * math.log2(row.frequency_hz / self.found_hz)

    def reduced(self, values: Sequence[float]) -> float:
        """Reduce values to one number; NaN if there are none."""
        return _REDUCE[self.of](values) if values else math.nan

    def known(self, rows: Iterable[Row]) -> list[tuple[Row, float]]:
        """Selected rows that have the metric, with its value."""
        found = [(row, getattr(row, self.metric)) for row in rows if self.selects(row)]
        return [(row, value) for row, value in found if value is not None]

    def selects(self, row: Row) -> bool:
        """Whether a row is selected."""
        same = all(getattr(self, name) in (None, getattr(row, name)) for name in KEY)
        above = self.from_hz is None or row.frequency_hz >= self.from_hz
        return same and above and (self.to_hz is None or row.frequency_hz <= self.to_hz)


def held(figures: Iterable[tuple[float, float]], times: float) -> float:
    """Octaves from the first frequency to where a figure first exceeds ``times`` its value there.

    Interpolation between frequencies is log-log. NaN where the figure is unknown at zero octaves, or where
    the sweep ends first.

    figures : octaves from the first frequency, negative on the other side, and the figure there
    """
    largest: dict[float, float] = {}
    for octave, value in figures:
        largest[octave] = max(value, largest.get(octave, value))
    if 0.0 not in largest:
        return math.nan
    most = times * largest[0.0]
    path = sorted((octave, value) for octave, value in largest.items() if octave >= 0.0)
    for (start, before), (stop, after) in pairwise(path):
        if after > most:
            return start + (stop - start) * math.log(most / before) / math.log(after / before)
    return math.nan


class Agreement(Strict):
    """Condition of agreement: a relative distance from the paper's figure, or bounds."""

    within: Agreed | None = Field(default=None, description="relative distance from the paper's number")
    at_most: Figure | None = Field(default=None, description="largest value that agrees")
    at_least: Figure | None = Field(default=None, description="least value that agrees")

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.within is None and self.at_most is None and self.at_least is None:
            raise ValueError("give within, at_most or at_least")
        return self

    def holds(self, value: float, paper: float | None) -> bool:
        """Whether a value agrees; NaN never does."""
        near = self.within is None or (paper is not None and abs(value - paper) <= self.within * abs(paper))
        below = self.at_most is None or value <= self.at_most
        return near and below and (self.at_least is None or value >= self.at_least) and not math.isnan(value)

    def words(self) -> str:
        """The condition in words."""
        if self.within is None and self.at_most is not None and self.at_least is not None:
            return f"{self.at_least:g} to {self.at_most:g}"
        parts = [
            "" if self.within is None else f"within {100 * self.within:g} %",
            "" if self.at_most is None else f"at most {self.at_most:g}",
            "" if self.at_least is None else f"at least {self.at_least:g}",
        ]
        return ", ".join(part for part in parts if part)


class Claim(Strict):
    """A statement, the paper's figure for it, the simulated quantity, and what counts as agreement."""

    id: Annotated[str, Field(min_length=1)] = Field(description="short name")
    statement: Annotated[str, Field(min_length=1)] = Field(description="statement of the paper")
    quote: str = Field(default="", description="its sentence, word for word; needed with a number")
    paper: Figure | None = Field(default=None, description="the paper's number, if it prints one")
    unit: str = Field(default="", description="unit of the numbers")
    quantity: Quantity = Field(description="simulated quantity")
    over: Quantity | None = Field(default=None, description="divide by this quantity")
    row_by_row: bool = Field(
        default=False,
        description=(
            "divide each row by that of the same axes, frequency and amplitude before the reduction"
        ),
    )
    factor: Figure = Field(default=1.0, description="multiply by this, such as 0.5 for half a height")
    agreement: Agreement = Field(description="condition of agreement")
    note: str = Field(default="", description="remark for readers if the claim is not met")
    calibrated: bool = Field(
        default=False,
        description="the actuator was fitted to this figure, so it is listed separately and not counted",
    )
    factors: tuple[FactorName, ...] | None = Field(
        default=None, description="possible causes to try if it is not met; all that apply if omitted"
    )

    @model_validator(mode="after")
    def _has_a_figure_to_be_near(self) -> Self:
        if self.agreement.within is not None and not self.paper:
            raise ValueError("agreement.within needs the paper's number")
        if self.paper is not None and not self.quote:
            raise ValueError("the paper's number needs the sentence that prints it, in quote")
        return self

    def value(self, rows: Sequence[Row]) -> float:
        """The simulated figure; infinite where a sweep beyond the least one wanted does not reach it."""
        if self.over is None:
            value, asked = self.quantity.value(rows), self.agreement
            endless = math.isnan(value) and asked.at_least is not None and asked.at_most is None
            if endless and self.quantity.covers(rows, asked.at_least or 0.0):
                return math.inf
            return self.factor * value
        if self.row_by_row:
            divisors = {_place(row): value for row, value in self.over.known(rows)}
            found = [(value, divisors.get(_place(row))) for row, value in self.quantity.known(rows)]
            return self.factor * self.quantity.reduced([value / by for value, by in found if by])
        divisor = self.over.value(rows)
        return self.factor * self.quantity.value(rows) / divisor if divisor else math.nan

    def selects(self, row: Row) -> bool:
        """Whether the figure uses a row."""
        return self.quantity.selects(row) or (self.over is not None and self.over.selects(row))


def _place(row: Row) -> tuple[object, ...]:
    """Key of a row among those of its compensator."""
    return tuple(getattr(row, name) for name in KEY if name != "compensator")
