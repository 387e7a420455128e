"""Variations of a scenario: values of any numeric key, and random actuators near the nominal one."""

import itertools
import math
import random
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hammerstein.arrays import Array
from hammerstein.blocks.instruments import Instruments
from hammerstein.dynamics import AxesDynamics, Axis, Dynamics, FeedbackHysteresisDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Hysteresis, Normals
from hammerstein.model import HammersteinModel
from hammerstein.quantities import BaseSamples, Deviation, Draws, Figure, Seed
from hammerstein.validation import Strict

MOST_VALUES = 1_000_000  # of a list in a file
TOGETHER = 1024  # samples of a Sobol sequence that are made at once

Values = Annotated[tuple[Figure, ...], Field(min_length=1, max_length=MOST_VALUES)]


class Study(Strict):
    """Runs of a scenario with other values of some keys, such as ``instruments.sensor.noise_um``.

    ``product`` is every combination of the values, ``zip`` the first values together, then the second ones.
    ``random`` and ``sobol`` take so many ``samples`` between the two values of each key.
    """

    how: Literal["product", "zip", "random", "sobol"] = Field(
        default="product",
        description="every combination of the values, the values in step, or random samples",
    )
    samples: Draws | None = Field(
        default=None, description="number of samples for random and sobol; for sobol a power of two"
    )
    seed: Seed = Field(default=1, description="seed of the samples")
    values: dict[str, Values] = Field(
        min_length=1,
        description=('values by key, such as "compensators[1].gain"; for samples, the two limits'),
    )

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        lengths = {key: len(values) for key, values in self.values.items()}
        if self.how in ("random", "sobol"):
            if self.samples is None:
                raise ValueError(f"how = {self.how!r} needs samples")
            if bad := [
                key for key, values in self.values.items() if len(values) != 2 or values[0] >= values[1]
            ]:
                raise ValueError(f"{bad[0]} needs two limits, the lower one first")
            if self.how == "sobol" and self.samples & (self.samples - 1):
                near = 2 ** round(math.log2(self.samples))
                raise ValueError(f"samples must be a power of two for sobol; {near} is near")
        elif self.samples is not None:
            raise ValueError(f"samples belongs to random and sobol, not to {self.how}")
        elif self.how == "zip" and len(set(lengths.values())) != 1:
            told = ", ".join(f"{key} {length}" for key, length in lengths.items())
            raise ValueError(f"zip needs equally many values of each key: {told}")
        return self

    def count(self) -> int:
        """Number of runs."""
        if self.samples is not None:
            return self.samples
        lengths = [len(values) for values in self.values.values()]
        return lengths[0] if self.how == "zip" else math.prod(lengths)

    def some(self, count: int) -> Iterator[dict[str, float]]:
        """Values of a given number of representative runs, or of all runs if there are fewer."""
        if self.samples is not None or self.count() <= count:
            yield from itertools.islice(self.points(), count)
            return
        chance = random.Random(self.seed)
        for _ in range(count):
            place = chance.random()
            places = {key: place if self.how == "zip" else chance.random() for key in self.values}
            yield {key: values[int(len(values) * places[key])] for key, values in self.values.items()}

    def ends(self) -> Iterator[dict[str, float]]:
        """Values of the runs in which a key is smallest or largest, with the other keys of these runs."""
        for values, end in itertools.product(self.values.values(), (min, max)):
            place = values.index(end(values))
            yield {key: others[min(place, len(others) - 1)] for key, others in self.values.items()}

    def points(self) -> Iterator[dict[str, float]]:
        """Values of every run by key, streamed."""
        keys, lists = list(self.values), list(self.values.values())
        if self.how in ("random", "sobol"):
            for place in self._places(len(keys)):
                ends = zip(keys, lists, place, strict=True)
                yield {key: low + (high - low) * at for key, (low, high), at in ends}
            return
        for found in itertools.product(*lists) if self.how == "product" else zip(*lists, strict=True):
            yield dict(zip(keys, found, strict=True))

    def _places(self, size: int) -> Iterator[list[float]]:
        """Samples in the unit cube."""
        from scipy.stats import qmc

        assert self.samples is not None
        generator = np.random.default_rng(self.seed)
        sampler = qmc.Sobol(size, rng=generator) if self.how == "sobol" else None
        for first in range(0, self.samples, TOGETHER):
            count = min(TOGETHER, self.samples - first)
            yield from (sampler.random(count) if sampler else generator.random((count, size))).tolist()


class _Given:
    """Numbers that were chosen beforehand."""

    def __init__(self, numbers: Array) -> None:
        self.left = numbers

    def standard_normal(self, size: Any = None) -> Any:
        """One number, or an array."""
        count = 1 if size is None else size
        given, self.left = self.left[:count], self.left[count:]
        return given[0] if size is None else given


Drawn = tuple[HammersteinModel, Instruments]
"""One random actuator."""


class Parameter(NamedTuple):
    """Uncertain parameter: its name, number of normal numbers, and whether it varies."""

    name: str
    size: int
    varies: bool


class Uncertainty(Strict):
    """Relative standard deviations of the actuator's parameters; each draw is another actuator.

    Frequencies, dampings, creep gains and noise are multiplied by exp(s g), g standard normal, so that they
    stay positive. Each weight gets s |w| g added; or all parameters that an identification found are drawn
    together, with the factor of their joint covariance: thresholds, axes, and the weights that follow them.
    Where thresholds were fitted, these draws follow Student's t (``ParameterCovariance.degrees``).
    """

    draws: Draws = Field(default=50, description="number of random actuators")
    seed: Seed = Field(default=1, description="seed of the draws")
    weights: Deviation | Literal["standard_errors"] = Field(
        default=0.0,
        description=(
            'relative standard deviation of the weights, or "standard_errors": all '
            "parameters by the covariance in the model file"
        ),
    )
    resonance: Deviation = Field(default=0.0, description="relative standard deviation of the resonances")
    damping: Deviation = Field(default=0.0, description="relative standard deviation of the damping ratios")
    creep: Deviation = Field(default=0.0, description="relative standard deviation of the creep gains")
    noise: Deviation = Field(default=0.0, description="relative standard deviation of the sensor's noise")
    sensitivity: BaseSamples | None = Field(
        default=None,
        description="base samples, a power of two, for the sensitivity of each parameter",
    )

    @field_validator("sensitivity")
    @classmethod
    def _is_a_power_of_two(cls, samples: int | None) -> int | None:
        if samples is not None and samples & (samples - 1):
            near = 2 ** round(math.log2(samples))
            raise ValueError(f"must be a power of two, as a Sobol sequence needs it; {near} is near")
        return samples

    def draw(self, model: HammersteinModel, instruments: Instruments, number: int) -> Drawn:
        """Actuator and instruments of one draw, independent of the number of draws.

        Raises InputError where standard errors are asked for and the model has no covariance, or where axes
        are perturbed and the dynamics have none.
        """
        return self.drawn(model, instruments, np.random.default_rng([self.seed, number]))

    def of(self, model: HammersteinModel, instruments: Instruments, normal: Array) -> Drawn:
        """Actuator and instruments of standard normal numbers, in the order of ``parameters``."""
        given = _Given(normal)
        found = self.drawn(model, instruments, given)
        assert not len(given.left), "parameters() and drawn() differ"
        return found

    def parameters(self, model: HammersteinModel) -> tuple[Parameter, ...]:
        """Drawn parameters, in this order; correlated errors of weights are one parameter."""
        known = model.covariance if isinstance(self.weights, str) else None
        beside = len(known.factor) + known.degrees if known else 0
        found = [Parameter("numbers beside the weights", beside, True)] if known else []
        found += [
            Parameter(f"weights of {name}", len(weights), bool(self.weights))
            for name, weights in zip(model.outputs, model.hysteresis.weights, strict=True)
        ]
        inside = None if isinstance(self.weights, str) else _inside(model)  # errors are of those before it
        found += [
            Parameter(f"weights in the loop, output {number}", len(weights), bool(self.weights))
            for number, weights in enumerate(inside.weights if inside else (), start=1)
        ]
        axes = model.dynamics.axes if isinstance(model.dynamics, AxesDynamics) else ()
        for name, axis in zip(model.outputs, axes, strict=False):
            if axis.resonance_hz is not None:
                found.append(Parameter(f"resonance of {name}", 1, self.resonance > 0.0))
                found.append(Parameter(f"damping of {name}", 1, self.damping > 0.0))
            found.append(
                Parameter(f"creep of {name}", len(axis.creep), self.creep > 0.0 and bool(axis.creep))
            )
        return (*found, Parameter("noise", 1, self.noise > 0.0))

    def drawn(self, model: HammersteinModel, instruments: Instruments, generator: Normals) -> Drawn:
        """Actuator and instruments from standard normal numbers of a generator."""
        drawn = _weights_drawn(model, self.weights, generator)
        drawn = replace(drawn, dynamics=self._dynamics_drawn(drawn, generator), covariance=None)
        noise = instruments.sensor.noise_um * _factor(self.noise, generator)
        sensor = instruments.sensor.model_copy(update={"noise_um": noise})
        return drawn, instruments.model_copy(update={"sensor": sensor})

    def _dynamics_drawn(self, model: HammersteinModel, generator: Normals) -> Dynamics:
        dynamics = model.dynamics
        axes = dynamics.axes if isinstance(dynamics, AxesDynamics) else ()
        rings = any(axis.resonance_hz is not None for axis in axes)
        if ((self.resonance or self.damping) and not rings) or (self.creep and not axes):
            what = f"{model.name} has no axes with a resonance; dynamics of kind {dynamics.kind} do not vary"
            raise InputError("uncertainty", what)
        drawn = tuple(self._axis_drawn(axis, generator) for axis in axes)
        return dynamics.model_copy(update={"axes": drawn} if axes else {})

    def _axis_drawn(self, axis: Axis, generator: Normals) -> Axis:
        drawn: dict[str, object] = {}
        if axis.resonance_hz is not None and axis.damping_ratio is not None:
            drawn["resonance_hz"] = axis.resonance_hz * _factor(self.resonance, generator)
            drawn["damping_ratio"] = axis.damping_ratio * _factor(self.damping, generator)
        drawn["creep"] = tuple(
            mode.model_copy(update={"gain": mode.gain * _factor(self.creep, generator)})
            for mode in axis.creep
        )
        return axis.model_copy(update=drawn)


def _factor(relative: float, generator: Normals) -> float:
    return float(np.exp(relative * generator.standard_normal()))


def _inside(model: HammersteinModel) -> Hysteresis[Any] | None:
    """Hysteresis in the loop of the dynamics, if its weights are numbers of its own."""
    dynamics = model.dynamics
    return dynamics.hysteresis.hysteresis() if isinstance(dynamics, FeedbackHysteresisDynamics) else None


def _varied(hysteresis: Hysteresis[Any], relative: float, generator: Normals) -> Hysteresis[Any]:
    """The same with every weight off by a normal relative deviation."""
    drawn = [own + relative * np.abs(own) * generator.standard_normal(len(own)) for own in hysteresis.weights]
    return hysteresis.with_weights(drawn)


def _weights_drawn(model: HammersteinModel, relative: float | str, generator: Normals) -> HammersteinModel:
    hysteresis, inside = model.hysteresis, _inside(model)
    if not isinstance(relative, str):
        model = replace(model, hysteresis=_varied(hysteresis, relative, generator))
        if inside is None:
            return model
        file = _varied(inside, relative, generator).file()
        return replace(model, dynamics=model.dynamics.model_copy(update={"hysteresis": file}))
    if hysteresis.weight_covariance is None:
        raise InputError(
            "uncertainty.weights",
            "the actuator's model does not state the covariance of its weights; identify it again, "
            "or give a relative deviation",
        )
    return model.drawn(generator)
