"""Records during identification, the models fitted to them, and what a person is told of the chosen one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import Dynamics, LinearBlock
from hammerstein.hysteresis import Hysteresis
from hammerstein.identification.linear.axis_fit import AxisFit
from hammerstein.identification.model_selection import CurvePoint, Trial
from hammerstein.identification.score import Candidate, Score
from hammerstein.identification.search import delay_in_samples
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import StaticFit, Thresholds
from hammerstein.model.covariance import ParameterCovariance
from hammerstein.notebook_repr import NotebookRepr
from hammerstein.records.record import Record

Progress = Callable[[str], None]
Kind = Literal["linear", "static_hysteresis", "linear_dynamics", "classical", "hammerstein", "in_loop"]

KIND_NAMES: Mapping[Kind, str] = {
    "linear": "linear gain",
    "static_hysteresis": "static hysteresis",
    "linear_dynamics": "linear dynamics alone",
    "classical": "this model with plays alone",
    "hammerstein": "Hammerstein",
    "in_loop": "hysteresis in the loop",
}


@dataclass(frozen=True, eq=False)
class Task:
    """Records with all information from before the fit of the candidates.

    Delays are those beside the sensor's. ``static_delay_samples`` is the delay that suits a model without
    dynamics, where it is another.
    """

    records: tuple[Record, ...]
    starts: tuple[InitialState, ...]
    thresholds_v: Thresholds
    delay_samples: float
    settings: Settings
    progress: Progress
    static_delay_samples: int | None = None

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.records[0].y_um)

    @property
    def readings(self) -> int:
        """Samples of all records and outputs."""
        return sum(record.y_um.size for record in self.records)

    def linear_thresholds(self) -> list[list[Array]]:
        """Return a single threshold of 0 to every pair: a linear gain."""
        return [[np.zeros(min(len(r), 1)) for r in row] for row in self.thresholds_v]

    @property
    def whole_delay(self) -> int:
        """Whole samples of the delay, which shift the plays; the remainder belongs to the path."""
        return math.floor(self.delay_samples)

    def delayed_as(self, dynamics: Dynamics) -> Task:
        """Return the task with the delay of a linear block."""
        delay = delay_in_samples(dynamics.input_delay_s, self.records[0].sample_time_s)
        return replace(self, delay_samples=delay)

    def paths(self, dynamics: Dynamics) -> list[LinearBlock]:
        """Discrete path of each record from the static block to the reading, with the part of a sample."""
        part_s = (self.delay_samples - self.whole_delay) * self.records[0].sample_time_s
        return self.settings.sensor.paths(dynamics.model_copy(update={"input_delay_s": part_s}), self.records)

    def candidate(self, hysteresis: Hysteresis[Any], dynamics: Dynamics) -> Candidate:
        """Static block and linear block as a model with the delay of the task."""
        delay_s = self.delay_samples * self.records[0].sample_time_s
        late = dynamics.model_copy(update={"input_delay_s": delay_s})
        return Candidate(hysteresis, late, self.settings.sensor)


@dataclass(frozen=True, eq=False)
class WeightFits:
    """Static block by several methods, behind the same linear block.

    ``chosen`` is by the requested solver; ``free`` and ``one_sign`` serve for comparison; ``fitted`` is true
    if the thresholds were fitted.
    """

    chosen: StaticFit
    free: StaticFit
    one_sign: StaticFit | None
    fitted: bool = False


@dataclass(frozen=True, eq=False)
class FittedModel:
    """Fitted model with details of its fit."""

    candidate: Candidate
    blocks: WeightFits
    axes: tuple[AxisFit, ...] = ()


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """All fitted models: the best of each kind, and others by name.

    ``axes`` holds the fitted axes, also where the model has none; ``untold`` the parameters of the kind of
    hysteresis that the records do not identify, so that plays are as good; ``alone`` that kind without
    dynamics.
    """

    found: dict[Kind, FittedModel]
    kind: Kind
    axes: tuple[AxisFit, ...] = ()
    notes: tuple[str, ...] = ()
    others: tuple[tuple[str, FittedModel], ...] = ()
    untold: str = ""
    alone: Candidate | None = None

    @property
    def best(self) -> FittedModel:
        """Largest accepted model."""
        return self.found[self.kind]

    @property
    def candidates(self) -> dict[Kind, Candidate]:
        """The models by kind."""
        return {kind: found.candidate for kind, found in self.found.items()}


def thresholds_of(blocks: WeightFits) -> list[list[Array]]:
    """Thresholds (output, input) of the block by the requested solver [V]."""
    return [[pair.thresholds_v for pair in row] for row in blocks.chosen.hysteresis.pairs]


_NOT_PLAIN = {"candidates", "alone", "covariance", "records", "held", "held_starts"}


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Fit(NotebookRepr):
    """Origin of a model, and its accuracy.

    Parameters
    ----------
    inputs, outputs : names of the axes
    kind : kind of model
    fit : errors of each kind of model on the records it was fitted to
    validation : the same on the validation records; empty without any
    solver : method that found the weights
    operators : (output, input) number of thresholds of each pair
    amplitude_v : largest half swing of an input in the records [V]
    amplitudes_v : (input,) half swing of each one [V]
    voltages : working point and range of the records
    delay_samples : delay of the outputs in samples, without the sensor's delay
    sample_time_s : time between samples of the records [s]
    sensor_bandwidth_hz : assumed bandwidth of the sensor [Hz]
    sensor_delay_s : assumed delay of its readings [s]; not in ``delay_samples``
    offsets_um : (record, output) reading at an output of zero [um]
    starts : initial state of each record
    held_starts : the same for the validation records
    axes : resonances and damping with their standard errors, where the model has them
    trials : every model that was tried, with its cross-validation error
    order : order of a state-space model
    error_curve : cross-validation error against the number of operators
    not_identifiable : parameters that the records do not identify
    flags : effects that a model of this kind cannot represent
    notes : notes on the records and the fit
    invertible : whether the model has an inverse
    invertibility : the same as a sentence, with the frequency or the slope that prevents it
    verdict : conclusion: blocks that improve the model, errors and flags
    candidates : the models of these errors
    covariance : of all parameters of the model together
    records, held : the fitted and the validation records, without their initial rest
    alone : another kind of hysteresis than plays, without dynamics
    other_kinds : whether the error is far above the noise with fitted thresholds, and plays alone were tried
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    kind: Kind
    fit: Mapping[Kind, Score]
    validation: Mapping[Kind, Score]
    solver: str
    operators: tuple[tuple[int, ...], ...]
    amplitude_v: float
    amplitudes_v: tuple[float, ...]
    voltages: Voltages
    delay_samples: float = 0.0
    sample_time_s: float
    sensor_bandwidth_hz: float | None = None
    sensor_delay_s: float = 0.0
    offsets_um: tuple[tuple[float, ...], ...]
    starts: tuple[InitialState, ...]
    held_starts: tuple[InitialState, ...]
    axes: tuple[AxisFit, ...] = ()
    trials: tuple[Trial, ...]
    order: int | None
    error_curve: tuple[CurvePoint, ...] = ()
    not_identifiable: tuple[str, ...] = ()
    flags: tuple[str, ...]
    notes: tuple[str, ...]
    invertible: bool
    invertibility: str
    verdict: str
    candidates: Mapping[Kind, Candidate]
    covariance: ParameterCovariance | None = None
    records: tuple[Record, ...]
    held: tuple[Record, ...]
    alone: Candidate | None = None
    other_kinds: bool = False

    def __repr__(self) -> str:
        errors = self.judged[self.kind].nrmse_percent
        left = ", ".join(f"{name} {e:.3g} %" for name, e in zip(self.outputs, errors, strict=True))
        where = "on validation records" if self.validation else "on the fitted records"
        flagged = f"; {len(self.flags)} flags" if self.flags else ""
        return f"Fit({self.kind}: {left} of the range {where}{flagged})"

    @property
    def judged(self) -> Mapping[Kind, Score]:
        """Errors that the verdict uses: on validation records, if there are any."""
        return self.validation or self.fit

    @property
    def is_static(self) -> bool:
        """Whether the chosen model has no linear block."""
        return self.kind in ("linear", "static_hysteresis")

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON: ``fit`` and ``validation`` hold the errors of each kind of model."""
        plain = {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in _NOT_PLAIN}
        return plain | {
            "voltages": self.voltages.model_dump(mode="json"),
            "fit": {kind: asdict(score) for kind, score in self.fit.items()},
            "validation": {kind: asdict(score) for kind, score in self.validation.items()},
            "starts": [asdict(start) for start in self.starts],
            "axes": [_plain(axis) for axis in self.axes],
            "trials": [
                {"name": t.name, "parameters": t.parameters, "percent": finite(t.percent), "kept": t.kept}
                for t in self.trials
            ],
            "error_curve": [asdict(point) for point in self.error_curve],
        }


def _plain(axis: AxisFit) -> dict[str, Any]:
    found = asdict(replace(axis, unsure=None)) | {"axis": axis.axis.model_dump(mode="json")}
    del found["unsure"]  # only words are made of it
    return found


def finite(value: float) -> float | None:
    """Return the number, or None where it is none: JSON has no infinity."""
    return value if math.isfinite(value) else None
