"""Claims of a publication, answered by the rows of a run."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveFloat, model_validator
from pydantic_core import PydanticKnownError

from hammerstein.errors import InputError
from hammerstein.metrics import KEY, METRICS, Row

_STRICT = ConfigDict(frozen=True, extra="forbid")


def _known(name: str) -> str:
    if name not in METRICS:
        raise PydanticKnownError("literal_error", {"expected": ", ".join(map(repr, METRICS))})
    return name


def _named(schema: dict[str, Any]) -> None:
    schema["enum"] = list(METRICS)


MetricName = Annotated[str, AfterValidator(_known), Field(json_schema_extra=_named)]
"""Name of a figure of merit, those of plug-ins included."""

_REDUCE: dict[str, Callable[[Sequence[float]], float]] = {
    "max": max,
    "min": min,
    "mean": lambda values: float(np.mean(values)),
    "spread": lambda values: max(values) / min(values),
}


class Quantity(BaseModel):
    """A number found in the rows of a report.

    ``metric`` of the rows that ``where`` selects, reduced by ``of``; in ``spread`` the largest is divided
    by the smallest.
    """

    model_config = _STRICT

    metric: MetricName
    compensator: str | None = None
    excited_axis: str | None = None
    measured_axis: str | None = None
    frequency_hz: PositiveFloat | None = None
    from_hz: PositiveFloat | None = None
    to_hz: PositiveFloat | None = None
    amplitude_v: PositiveFloat | None = None
    amplitude_um: PositiveFloat | None = None
    of: Literal["max", "min", "mean", "spread"] = "max"

    def value(self, rows: Iterable[Row]) -> float:
        """The number; NaN where no row is selected."""
        values = [getattr(row, self.metric) for row in rows if self._selects(row)]
        known = [value for value in values if value is not None]
        return _REDUCE[self.of](known) if known else math.nan

    def _selects(self, row: Row) -> bool:
        same = all(getattr(self, name) in (None, getattr(row, name)) for name in KEY)
        above = self.from_hz is None or row.frequency_hz >= self.from_hz
        return same and above and (self.to_hz is None or row.frequency_hz <= self.to_hz)


class Agreement(BaseModel):
    """What counts as agreement: a relative distance from the paper's figure, or bounds."""

    model_config = _STRICT

    within: PositiveFloat | None = Field(
        default=None, description="relative distance from the paper's figure"
    )
    at_most: float | None = None
    at_least: float | None = None

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
        """Say it as a person would."""
        parts = [
            "" if self.within is None else f"within {100 * self.within:g} %",
            "" if self.at_most is None else f"at most {self.at_most:g}",
            "" if self.at_least is None else f"at least {self.at_least:g}",
        ]
        return ", ".join(part for part in parts if part)


class Claim(BaseModel):
    """A statement, the paper's figure for it, the quantity that answers it, and what counts as agreement."""

    model_config = _STRICT

    id: Annotated[str, Field(min_length=1)]
    statement: Annotated[str, Field(min_length=1)]
    paper: float | None = Field(default=None, description="the paper's figure, if it prints one")
    unit: str = ""
    quantity: Quantity
    over: Quantity | None = Field(default=None, description="divide by this quantity")
    factor: float = Field(default=1.0, description="multiply by this, such as 0.5 for half a height")
    agreement: Agreement
    note: str = Field(default="", description="what a reader should know if the claim is not met")

    @model_validator(mode="after")
    def _has_a_figure_to_be_near(self) -> Self:
        if self.agreement.within is not None and not self.paper:
            raise ValueError("agreement.within needs the paper's figure")
        return self

    def of_true_position(self) -> Claim | None:
        """The same claim on the true position, where its metric has such a twin."""
        twin = self.quantity.metric.replace("_um", "_true_um")
        if twin not in METRICS or "true" in self.quantity.metric:
            return None
        return self.model_copy(update={"quantity": self.quantity.model_copy(update={"metric": twin})})

    def value(self, rows: Sequence[Row]) -> float:
        """The simulated figure."""
        divisor = 1.0 if self.over is None else self.over.value(rows)
        return self.factor * self.quantity.value(rows) / divisor if divisor else math.nan


@dataclass(frozen=True)
class Answer:
    """What one actuator answers to a claim."""

    actuator: str
    value: float
    agrees: bool

    def as_dict(self) -> dict[str, object]:
        """Give plain JSON; a value that does not exist is left out."""
        return {k: v for k, v in asdict(self).items() if k != "value" or math.isfinite(self.value)}


@dataclass(frozen=True)
class Verdict:
    """A claim and what the simulated actuators answer; the first is the scenario's own."""

    id: str
    statement: str
    paper: float | None
    unit: str
    wanted: str
    answers: tuple[Answer, ...]
    reason: str

    @property
    def ratio(self) -> float | None:
        """Simulated over paper, for the scenario's own actuator."""
        return self.answers[0].value / self.paper if self.paper else None

    @property
    def agrees(self) -> bool:
        """Whether the scenario's own actuator agrees."""
        return self.answers[0].agrees

    def as_dict(self) -> dict[str, object]:
        """Give plain JSON; a figure that does not exist is left out."""
        content = {k: v for k, v in asdict(self).items() if v is not None}
        content["answers"] = [
            {k: v for k, v in asdict(a).items() if k != "value" or math.isfinite(a.value)}
            for a in self.answers
        ]
        return content | {"verdict": "met" if self.agrees else "not met"}


def verdicts(
    claims: Sequence[Claim],
    rows_by_actuator: Mapping[str, Sequence[Row]],
    static: str = "duo_bimorph_static",
) -> tuple[Verdict, ...]:
    """Answer every claim with the rows of every actuator; the first actuator is the scenario's own.

    ``static`` names the actuator without dynamics: where a claim is not met, what it answers tells whether
    the dynamics are the cause, and the true positions tell what the sensor adds.

    Raises InputError where a claim selects no row.
    """
    found = []
    for claim in claims:
        answers = []
        for actuator, rows in rows_by_actuator.items():
            value = claim.value(rows)
            answers.append(Answer(actuator, value, claim.agreement.holds(value, claim.paper)))
        if math.isnan(answers[0].value):
            raise InputError(f"claim {claim.id}", "selects no row that has this metric; look into rms.csv")
        own = next(iter(rows_by_actuator))
        measured = "" if answers[0].agrees else _reason(claim, own, static, rows_by_actuator)
        reason = f"{measured}. {claim.note}" if measured and claim.note else measured
        wanted = claim.agreement.words()
        found.append(
            Verdict(claim.id, claim.statement, claim.paper, claim.unit, wanted, tuple(answers), reason)
        )
    return tuple(found)


def _reason(claim: Claim, own: str, static: str, rows: Mapping[str, Sequence[Row]]) -> str:
    """Say what was measured of the cause: without the sensor, without the dynamics, without both."""
    true = claim.of_true_position()
    measured = []
    if true is not None:
        measured.append(("at the true position", true.value(rows[own])))
    if static in rows and static != own:
        measured.append(("without dynamics", claim.value(rows[static])))
        if true is not None:
            measured.append(("without both", true.value(rows[static])))
    known = [(words, value) for words, value in measured if not math.isnan(value)]
    if not known:
        return "no other actuator was asked for the cause"
    cause = next((w for w, v in known if claim.agreement.holds(v, claim.paper)), None)
    causes = {"at the true position": "the sensor's lag and noise", "without dynamics": "the dynamics"}
    verdict = causes.get(
        cause or "", "dynamics and sensor together" if cause else "in the law or the loop itself"
    )
    return f"{verdict}: " + ", ".join(f"{words} {value:.3g}" for words, value in known)
