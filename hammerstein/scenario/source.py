"""Source of a model: an identification experiment, or a model file."""

from __future__ import annotations

import sys
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from hammerstein.compensators import COMPENSATORS, Compensator
from hammerstein.compensators.learning import Learned  # noqa: F401  (a kind of compensator that registers itself)
from hammerstein.hysteresis.kind import refuse_unbuilt
from hammerstein.identification.options import (
    FEWEST_EXPERIMENTS,
    Count,
    DeadZones,
    Kind,
    LinearBlock,
    Order,
    Placed,
)
from hammerstein.quantities import (
    Cycles,
    FileName,
    Frequency,
    Length,
    Modes,
    Operators,
    Range,
    SampleTime,
    Size,
)
from hammerstein.signals import MOST_LINES
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.identification.settings import Settings


Frequencies = Annotated[tuple[Frequency, ...], Field(min_length=1, max_length=1000)]


OwnAmplitude = Annotated[
    Size | None,
    Field(description="amplitude about the middle of the actuator's range; the whole range if omitted"),
]
OwnSampleTime = Annotated[
    SampleTime | None,
    Field(description="sample time of this experiment, if it differs from that of the run"),
]


class ClosedFormSpec(Strict):
    """Identify the static block by the paper's closed form, one input driven at a time (section 3.3)."""

    method: Literal["closed_form"] = "closed_form"
    frequency_hz: Frequency = Field(default=50.0, description="frequency of the recorded sine")
    amplitude_v: OwnAmplitude = None
    waveform: Literal["sine", "triangle"] | None = Field(
        default=None, description="drive of the input; a sine if omitted"
    )
    operators: Operators = Field(default=15, description="plays of each pair of axes")
    settle_cycles: Cycles = Field(default=5, description="cycles before the record")
    measured_cycles: Cycles = Field(default=10, description="recorded cycles, whose mean is used")
    sample_time_s: OwnSampleTime = None

    @property
    def highest_frequency_hz(self) -> float:
        """Highest frequency of the drive [Hz]."""
        return self.frequency_hz


class JointFitSpec(Strict):
    """Identify hysteresis and dynamics together by least squares through the linear block and the sensor.

    Each input in turn is driven by sines at the given frequencies, then by a multisine; with creep, slow
    steps on all inputs come last. The sensor's bandwidth is taken from its data sheet.
    """

    method: Literal["hammerstein"]
    amplitude_v: OwnAmplitude = None
    operators: Count = 15
    partition: Placed = "time"
    frequencies_hz: Frequencies = Field(default=(50.0,), description="frequencies of the recorded sines")
    record_s: Length = Field(default=0.1, description="duration of each sine and of the multisine")
    sample_time_s: OwnSampleTime = None
    hysteresis: Kind | None = Field(
        default=None,
        description="asymmetric, generalised, preisach, rate_dependent, bouc_wen or others; plays if omitted",
    )
    dead_zones: DeadZones = None
    dynamics: LinearBlock | None = Field(
        default=None, description="linear block of each axis; second_order, a resonance, if omitted"
    )
    creep_modes: Modes = Field(default=0, description="slow modes of each axis, from a separate record")
    creep_record_s: Length = Field(default=600.0, description="duration of the slow record")

    def settings(self) -> Settings:
        """Options of ``identify``, with equal names and meanings.

        Raises InputError for what does not go together.
        """
        from hammerstein.identification.settings import Settings

        same = JointFitSpec.model_fields.keys() & Settings.model_fields.keys()
        given = {"dynamics": "second_order"} | self.model_dump(include=same, exclude_none=True)
        return Settings(**given, error_curve=False)

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        refuse_unbuilt(self.settings)
        return self

    @property
    def highest_frequency_hz(self) -> float:
        """Highest frequency of the drive [Hz]."""
        return max(self.frequencies_hz)


Part = Annotated[float, Range(1e-3, 1.0)]


class LoopFitSpec(Strict):
    """Identify plays in the loop of a state space, as one model for every amplitude.

    All inputs are driven together, by multisines at several levels. Two settled periods of each are
    recorded, and freed of the sensor's lag; see ``identify_in_loop``.
    """

    method: Literal["hysteresis_in_loop"]
    highest_frequency_hz: Frequency = Field(description="highest line of the multisines")
    amplitude_v: OwnAmplitude = None
    levels: Annotated[tuple[Part, ...], Field(min_length=1, max_length=100)] = Field(
        default=(0.25, 0.5, 1.0), description="levels, in parts of the amplitude"
    )
    experiments: Annotated[int, Range(1, 1000)] = Field(default=2, description="multisines at each level")
    record_s: Length = Field(default=0.1, description="period of the multisines; lines are 1/period apart")
    order: Order = None
    minutes: Annotated[float, Range(0.1, 1440.0)] = Field(
        default=60.0, description="time limit of the search"
    )

    sample_time_s: ClassVar[None] = None  # its model has the grid of its records, which is that of the run

    @model_validator(mode="after")
    def _can_be_done(self) -> Self:
        if len(self.levels) * self.experiments < FEWEST_EXPERIMENTS:
            fewest = f"{FEWEST_EXPERIMENTS} or more, because some select the structure"
            raise ValueError(f"the number of levels times experiments must be {fewest}")
        if not 1.0 < self.highest_frequency_hz * self.record_s <= MOST_LINES:
            raise ValueError(f"highest_frequency_hz times record_s must be 1 to {MOST_LINES}, the lines")
        return self


def _method(value: Any) -> str:
    if isinstance(value, dict):
        return str(value.get("method", "closed_form"))
    return str(getattr(value, "method", "closed_form"))


IdentificationSpec = Annotated[
    Annotated[ClosedFormSpec, Tag("closed_form")]
    | Annotated[JointFitSpec, Tag("hammerstein")]
    | Annotated[LoopFitSpec, Tag("hysteresis_in_loop")],
    Discriminator(_method),
]


class ModelSource(Strict):
    """A labelled model: identified from a simulated experiment, or read from a model file."""

    label: Annotated[str, Field(min_length=1, max_length=60)] = Field(
        description="name in tables and figures"
    )
    identification: IdentificationSpec | None = Field(
        default=None, description="experiment that identifies the model, if no model is given"
    )
    model: FileName | None = Field(default=None, description="model file, or name of a packaged actuator")
    only_at_hz: Frequencies | None = Field(
        default=None, description="frequencies of the sweep at which it is tested; all if omitted"
    )

    def is_tested_at(self, frequency_hz: float) -> bool:
        """Whether this source is used at a frequency of the sweep."""
        return self.only_at_hz is None or frequency_hz in self.only_at_hz

    @property
    def is_tested(self) -> bool:
        """Whether it is used at all."""
        return self.only_at_hz != ()

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if (self.identification is None) == (self.model is None):
            raise ValueError("give either identification or model")
        return self


class TestedCompensator(ModelSource, Compensator):
    """A compensator with its label and the source of its model."""

    __test__ = False  # no test, whatever pytest thinks of its name

    @model_validator(mode="after")
    def _takes_its_model(self) -> Self:
        if isinstance(self.identification, LoopFitSpec) and (self.static or not self.takes_loop):
            raise ValueError(
                f"identification: {self.law} takes linear dynamics; with hysteresis_in_loop use "
                "hammerstein_inverse, learned or none"
            )
        return self


@cache
def _tested(kind: type[Compensator]) -> type[Compensator]:
    name = f"Tested{kind.__name__}"
    body = {"__doc__": kind.__doc__, "__module__": kind.__module__, "__test__": False}
    twin = type(name, (TestedCompensator, kind), body)
    setattr(sys.modules[kind.__module__], name, twin)  # where another process looks for it
    return twin


Tested = Annotated[TestedCompensator, COMPENSATORS.field(_tested)]
"""Any compensator, selected by its law."""
