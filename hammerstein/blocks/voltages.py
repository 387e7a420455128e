"""Recorded voltages and verdict of the identification, as stored in a model file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from hammerstein.quantities import Figure, Offset
from hammerstein.validation import Strict

ONE_SIDED = 0.25
"""Smaller side of 0 V, in parts of the larger one, up to which a record is one-sided."""

Poling = Literal["positive", "negative", "both"]


class Voltages(Strict):
    """Absolute voltages of the records of a model, one per input.

    The plays rest at the working point; the position there, at rest, is zero.
    """

    working_point_v: tuple[Offset, ...] = Field(description="voltage at which the plays are at rest")
    lowest_v: tuple[Offset, ...] = Field(description="lowest voltage of the records")
    highest_v: tuple[Offset, ...] = Field(description="highest voltage of the records")
    poling: tuple[Poling, ...] = Field(
        description=(
            "sign of the recorded voltages, if the opposite side is at most a quarter of the larger side"
        )
    )
    conditioned: bool = Field(
        default=False,
        description="whether the records began after a drive to the highest, then to the lowest voltage",
    )
    fastest_v_per_s: tuple[Figure, ...] = Field(
        default=(), description="fastest change of each voltage between two samples; none if unknown"
    )

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        each = (self.working_point_v, self.lowest_v, self.highest_v, self.poling)
        if len(set(map(len, each))) != 1:
            raise ValueError("give as many working points, lowest and highest voltages and signs of poling")
        if len(self.fastest_v_per_s) not in (0, len(self.poling)):
            raise ValueError("give as many values of fastest_v_per_s as of lowest_v, or none")
        if any(low >= high for low, high in zip(self.lowest_v, self.highest_v, strict=True)):
            raise ValueError("lowest_v must lie below highest_v")
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_usual(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        plain: dict[str, Any] = handler(self)
        return {name: value for name, value in plain.items() if value is not False and value != ()}

    @classmethod
    def of(cls, working_point_v: ArrayLike, lowest_v: ArrayLike, highest_v: ArrayLike) -> Voltages:
        """Voltages (m,) of records; the sign of poling follows from them.

        >>> Voltages.of([0.0, 0.0], [-20.0, -50.0], [120.0, 50.0]).poling
        ('positive', 'both')
        """
        given = {"working_point_v": working_point_v, "lowest_v": lowest_v, "highest_v": highest_v}
        values = {name: tuple(np.asarray(v, dtype=np.float64).tolist()) for name, v in given.items()}
        return cls(**values, poling=tuple(map(_poling, values["lowest_v"], values["highest_v"])))

    @classmethod
    def symmetric(cls, amplitude_v: float, inputs: int) -> Voltages:
        """Symmetric about 0 V, the default of a model file."""
        ends = np.full(inputs, amplitude_v)
        return cls.of(np.zeros(inputs), -ends, ends)

    def one_sided(self) -> list[int]:
        """Inputs, from 0, whose records stayed on one side of 0 V."""
        return [k for k, sign in enumerate(self.poling) if sign != "both"]

    def statement(self, inputs: Sequence[str]) -> str:
        """State the recorded range and the working point of each input."""
        past = " after both ends" * self.conditioned
        ends = zip(inputs, self.lowest_v, self.highest_v, self.working_point_v, strict=True)
        return "; ".join(
            f"{name} from {low:.6g} to {high:.6g} V, at rest at {rest:.6g} V{past}"
            for name, low, high, rest in ends
        )


def _poling(low: float, high: float) -> Poling:
    if low >= -ONE_SIDED * high and high > 0.0:
        return "positive"
    return "negative" if high <= -ONE_SIDED * low and low < 0.0 else "both"


class Verdict(Strict):
    """Verdict of the identification of a model."""

    flagged: bool = Field(description="whether the records show an effect that this model cannot represent")
    statements: tuple[str, ...] = Field(default=(), description="effects that it cannot represent")
    held_out: bool = Field(default=False, description="whether the error is from a validation record")
    sentence: str = Field(default="", description="blocks that lower the error")
    nrmse_percent: tuple[Figure, ...] = Field(
        default=(), description="error of each output on the records used for the verdict"
    )
    rms_um: tuple[Figure, ...] = Field(
        default=(), description="the same in um, with the noise of the records"
    )
    noise_um: tuple[Figure, ...] = Field(default=(), description="white noise of the records in that error")
    largest_um: tuple[Figure, ...] = Field(default=(), description="largest error about its mean in a record")
    rest_um: tuple[Figure, ...] = Field(
        default=(),
        description="error of each output at rest, about the mean error of its record; none where no record "
        "begins at rest",
    )

    def error(self, outputs: Sequence[str]) -> str:
        """Error of a model in words, by the names of its outputs; empty if it was not tested.

        >>> Verdict(flagged=False, held_out=True, nrmse_percent=(0.45, 2.0)).error(("x", "y"))
        '0.45 % of the range of x and 2 % of that of y on validation records'
        """
        if len(self.nrmse_percent) != len(outputs):
            return ""
        pairs = zip(self.nrmse_percent, outputs, strict=True)
        first, *others = (f"{percent:.2g} % of the range of {name}" for percent, name in pairs)
        told = " and ".join([first, *(text.replace("the range", "that") for text in others)])
        return f"{told} on {'validation records' if self.held_out else 'the records used for the fit'}"
