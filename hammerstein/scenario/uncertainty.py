"""How uncertain the actuator is: draws of an actuator near the nominal one."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from hammerstein.dynamics import AxesDynamics, Axis, StateSpaceDynamics, StaticDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.instruments import Instruments
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Deviation, Draws, Seed

Array = NDArray[np.float64]


class Uncertainty(BaseModel):
    """Relative standard deviations of the actuator's parameters; each draw is another actuator.

    Frequencies, dampings, creep gains and noise are multiplied by exp(s g), g standard normal, so that they
    stay positive. Each weight gets s |w| g added; or the weights of an output together get L g, with the
    factor L of their covariance, for the errors of neighbouring weights cancel.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    draws: Draws = 50
    seed: Seed = 1
    weights: Deviation | Literal["standard_errors"] = Field(
        default=0.0,
        description='relative, or "standard_errors": covariance in the actuator\'s model file',
    )
    resonance: Deviation = 0.0
    damping: Deviation = 0.0
    creep: Deviation = 0.0
    noise: Deviation = 0.0

    def draw(
        self, model: HammersteinModel, instruments: Instruments, number: int
    ) -> tuple[HammersteinModel, Instruments]:
        """Actuator and instruments of one draw; it does not depend on how many are drawn.

        Raises InputError where standard errors are asked for and the model has no covariance, or where axes
        are perturbed and the dynamics have none.
        """
        generator = np.random.default_rng([self.seed, number])
        hysteresis = _weights_drawn(model.hysteresis, self.weights, generator)
        dynamics = self._dynamics_drawn(model, generator)
        drawn = replace(model, hysteresis=hysteresis, dynamics=dynamics)
        noise = instruments.sensor.noise_um * _factor(self.noise, generator)
        sensor = instruments.sensor.model_copy(update={"noise_um": noise})
        return drawn, instruments.model_copy(update={"sensor": sensor})

    def _dynamics_drawn(
        self, model: HammersteinModel, generator: np.random.Generator
    ) -> AxesDynamics | StaticDynamics | StateSpaceDynamics:
        dynamics = model.dynamics
        if isinstance(dynamics, AxesDynamics):
            axes = tuple(self._axis_drawn(axis, generator) for axis in dynamics.axes)
            return dynamics.model_copy(update={"axes": axes})
        if self.resonance or self.damping or self.creep:
            raise InputError(
                "uncertainty", f"{model.name} has no axes with a resonance that could be uncertain"
            )
        return dynamics

    def _axis_drawn(self, axis: Axis, generator: np.random.Generator) -> Axis:
        drawn: dict[str, object] = {}
        if axis.resonance_hz is not None and axis.damping_ratio is not None:
            drawn["resonance_hz"] = axis.resonance_hz * _factor(self.resonance, generator)
            drawn["damping_ratio"] = axis.damping_ratio * _factor(self.damping, generator)
        drawn["creep"] = tuple(
            mode.model_copy(update={"gain": mode.gain * _factor(self.creep, generator)})
            for mode in axis.creep
        )
        return axis.model_copy(update=drawn)


def _factor(relative: float, generator: np.random.Generator) -> float:
    return float(np.exp(relative * generator.standard_normal()))


def _weights_drawn(
    hysteresis: PrandtlIshlinskii, relative: float | str, generator: np.random.Generator
) -> PrandtlIshlinskii:
    rows = []
    for output, row in enumerate(hysteresis.pairs):
        weights = np.concatenate([pair.weights_um_per_v for pair in row])
        normal = generator.standard_normal(len(weights))
        drawn = weights + _deviations(hysteresis, output, weights, relative, normal)
        ends = np.cumsum([len(pair.thresholds_v) for pair in row])[:-1]
        pairs = zip(row, np.split(drawn, ends), strict=True)
        rows.append(tuple(Pair(pair.thresholds_v, own) for pair, own in pairs))
    return PrandtlIshlinskii(tuple(rows))


def _deviations(
    hysteresis: PrandtlIshlinskii, output: int, weights: Array, relative: float | str, normal: Array
) -> Array:
    """Deviations of all weights of one output, from as many standard normal numbers."""
    if not isinstance(relative, str):
        return np.asarray(relative * np.abs(weights) * normal)
    if hysteresis.weight_covariance is None:
        raise InputError(
            "uncertainty.weights",
            "the actuator's model does not say how the errors of its weights hang together; identify it "
            "again, or give a relative deviation",
        )
    return np.asarray(hysteresis.weight_covariance[output].factor_um_per_v @ normal)
