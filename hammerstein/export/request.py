"""Request of an export: model, law with options, limits of the drive, and the block that they make."""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators.attempt import compensator_of, sensorless_law
from hammerstein.compensators.drive_file import Terms
from hammerstein.dynamics import on_grid
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Offset, Plain, SampleTime
from hammerstein.validation import Strict, mistakes_in


class ForwardState(NamedTuple):
    """Memory of the hysteresis, and state (n,) of the block behind it."""

    hysteresis: Any
    linear: Array


class ForwardModel:
    """Positions of the model for absolute voltages, from rest at the working point.

    Parameters
    ----------
    model : hysteresis and dynamics
    range_v : what the drive gives; the model itself does not cut
    sample_time_s : for which each voltage is held [s]
    """

    def __init__(self, model: HammersteinModel, range_v: DriveRange, sample_time_s: float):
        self.model, self.range, self.sample_time_s = model.on_grid(sample_time_s), range_v, sample_time_s
        self.block = on_grid(model.dynamics, sample_time_s)
        self.n_inputs, self.n_outputs = model.hysteresis.n_inputs, model.hysteresis.n_outputs

    preview_samples = 0

    def statement(self) -> str:
        """State the conditions before the first sample."""
        said = "Before the first sample the actuator rests at its working point, without history."
        if not self.model.recorded.conditioned:
            return said
        return (
            f"{said} Its records began after both ends of their range: first drive it there, highest first."
        )

    def rest(self) -> ForwardState:
        """State of an actuator that was never driven."""
        return ForwardState(self.model.hysteresis.rest(), self.block.rest())

    def respond(self, drive_v: ArrayLike, start: ForwardState | None = None) -> tuple[Array, ForwardState]:
        """Positions (p, N) [um] for voltages (m, N), and the state after them."""
        start = start or self.rest()
        drive = np.atleast_2d(np.asarray(drive_v, dtype=np.float64))
        v, plays = self.model.static_response(drive, start.hysteresis)
        position, linear = self.block.respond(v, start.linear)
        return position, ForwardState(plays, linear)


MODEL = "model"
"""As a law: the actuator itself."""


class Request(Strict):
    """An export as its file keeps it, beside a copy of the model."""

    format: Literal["hammerstein-export/1"] = "hammerstein-export/1"
    source: str = Field(description="name of the model file")
    law: str
    options: dict[str, Plain] = Field(default_factory=dict, description="of the law, as in a scenario")
    range_v: tuple[Offset, ...] | None = Field(default=None, description="voltages that may be used")
    start_v: tuple[Offset, ...] | None = Field(default=None, description="voltage before the first sample")
    conditioned: bool | None = None
    accept_flagged: bool = False
    sample_time_s: SampleTime
    float32: bool = False
    form: Literal["c", "fmu"] = "c"
    fmi: Literal[2, 3] = Field(default=3, description="version of the unit")

    def terms(self) -> Terms:
        """What a person allows the drive to do."""
        return Terms(self.range_v, self.start_v, self.conditioned, accept_flagged=self.accept_flagged)

    def block(self, model: HammersteinModel) -> Law[Any] | ForwardModel:
        """The law, designed, or the model itself as a block.

        Raises
        ------
        InputError : invalid options, a range that is not finite, or a law that reads the sensor
        SimulationError : a law that cannot work
        IdentificationError : a model that its own fit report flags
        """
        self.terms().refuse_flagged(model, self.source)
        limits = self.terms().allowed_range(model)
        if self.law == MODEL:
            if self.options:
                raise InputError("--law model", f"takes no options; {', '.join(sorted(self.options))} is one")
            if self.conditioned:
                what = "applies to laws; the exported model starts at rest: drive it to both ends first"
                raise InputError("--conditioned", what)
            return ForwardModel(model, limits, self.sample_time_s)
        law = compensator_of(self.law, self.options)
        return sensorless_law(law, model, limits, self.sample_time_s)


def request_of(
    path: str, law: str, sample_time_s: float | None, **given: object
) -> tuple[Request, HammersteinModel]:
    """Request for a model file or a packaged actuator; its drive's sample time if none is given.

    Raises InputError where a number is beyond what it may be.
    """
    model = HammersteinModel.load(path)
    time_s = sample_time_s if sample_time_s is not None else model.instruments.drive.sample_time_s
    fields = {"source": Path(path).name, "law": law, "sample_time_s": time_s, **given}
    with mistakes_in("compensate", Request):
        return Request.model_validate(fields), model
