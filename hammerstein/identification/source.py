"""Where a model comes from: an identification experiment, or a model file."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PositiveFloat,
    PositiveInt,
    Tag,
    model_validator,
)

_STRICT = ConfigDict(frozen=True, extra="forbid")
Frequencies = Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]


class ClosedFormSpec(BaseModel):
    """Identify the static block by the paper's closed form, one input driven at a time (section 3.3)."""

    model_config = _STRICT

    method: Literal["closed_form"] = "closed_form"
    frequency_hz: PositiveFloat = 50.0
    amplitude_v: PositiveFloat | None = Field(
        default=None, description="about the middle of the actuator's range; all of that if not given"
    )
    waveform: Literal["sine", "triangle"] | None = Field(
        default=None, description="what drives the input: a sine if not given"
    )
    operators: PositiveInt = 15
    settle_cycles: PositiveInt = 5
    measured_cycles: PositiveInt = 10
    sample_time_s: PositiveFloat | None = Field(
        default=None, description="sample time of this experiment, where it is not that of the run"
    )


class JointFitSpec(BaseModel):
    """Identify hysteresis and dynamics together by least squares through the linear block and the sensor.

    Each input in turn is driven by sines at the given frequencies, then by a multisine; with creep, slow
    steps on all inputs come last. The sensor's bandwidth is taken from its data sheet. With partition
    ``fitted`` the thresholds are fitted, too, and ``operators`` is the most there are.
    """

    model_config = _STRICT

    method: Literal["hammerstein"]
    amplitude_v: PositiveFloat | None = Field(
        default=None, description="about the middle of the actuator's range; all of that if not given"
    )
    operators: PositiveInt = 15
    partition: Literal["time", "voltage", "fitted"] = "time"
    frequencies_hz: Frequencies = (50.0,)
    record_s: PositiveFloat = Field(default=0.1, description="length of each sine, and of the multisine")
    sample_time_s: PositiveFloat | None = Field(
        default=None, description="sample time of this experiment, where it is not that of the run"
    )
    creep_modes: int = Field(default=0, ge=0, le=5)
    creep_record_s: PositiveFloat = Field(default=600.0, description="length of the slow record")


def _method(value: Any) -> str:
    if isinstance(value, dict):
        return str(value.get("method", "closed_form"))
    return str(getattr(value, "method", "closed_form"))


IdentificationSpec = Annotated[
    Annotated[ClosedFormSpec, Tag("closed_form")] | Annotated[JointFitSpec, Tag("hammerstein")],
    Discriminator(_method),
]


class ModelSource(BaseModel):
    """A labelled model: identified from a simulated experiment, or read from a model file."""

    model_config = _STRICT

    label: Annotated[str, Field(min_length=1, max_length=60)]
    identification: IdentificationSpec | None = None
    model: str | None = Field(default=None, description="model file, or name of a packaged actuator")
    only_at_hz: Frequencies | None = Field(
        default=None, description="frequencies of the sweep at which it is tested; all if not given"
    )

    def is_tested_at(self, frequency_hz: float) -> bool:
        """Whether this source takes part at a frequency of the sweep."""
        return self.only_at_hz is None or frequency_hz in self.only_at_hz

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.identification is None) == (self.model is None):
            raise ValueError("give either identification or model")
        return self
