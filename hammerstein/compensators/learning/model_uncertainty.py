"""How far the actuator may be from its model at each frequency, and where learning converges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.dynamics import AxesDynamics, LinearBlock, discretise, linearised
from hammerstein.model import HammersteinModel

DEVIATIONS = 2.0  # standard deviations that are counted on
SURE = 0.5  # relative error up to which all of an error is learnt
FAINT = 10.0  # how many times weaker than at rest a model is no longer believed
WEIGHTS, RESONANCE = 0.05, 0.01
"""Relative errors of weights and of a resonance where a model file states none."""


@dataclass(frozen=True)
class ModelUncertainty:
    """Relative standard deviations of the weights and of the resonances of a model.

    Learning through the inverse of a model is ``e+ = (1 - Q T) e`` at each frequency, with T what the
    actuator does behind that inverse and Q a filter. Where ``|T - 1| <= delta < 1`` it converges for every Q
    from 0 to 1, by ``1 - Q (1 - delta)`` a trial at worst. So Q is 1 up to delta = 1/2 and falls to 0 at
    delta = 1.

    Source: Bristow, Tharayil and Alleyne, A survey of iterative learning control, IEEE Control Systems
    Magazine 26 (2006) 96-114.
    """

    weights: float = WEIGHTS
    resonance: float = RESONANCE

    def relative(self, model: HammersteinModel, frequency_hz: Array, sample_time_s: float) -> Array:
        """Bound delta (frequency, output) of the relative error of the model, two standard deviations.

        Infinite where the actuator responds with less than a tenth of what it does when it stands still:
        there it is another one, and its inverse would ask for more than a drive has.
        """
        ends = model.hysteresis.amplitude(model.amplitude_v).sum(axis=1)
        block = linearised(model.dynamics, sample_time_s, ends)
        response, still = _diagonal(block, frequency_hz), np.abs(_diagonal(block, np.zeros(1)))
        faint = np.abs(response) * FAINT < still
        delta = np.where(faint, np.inf, DEVIATIONS * self.weights)
        if not isinstance(model.dynamics, AxesDynamics) or self.resonance == 0.0:
            return delta
        worst = np.zeros(delta.shape)
        for factor in (1.0 - DEVIATIONS * self.resonance, 1.0 + DEVIATIONS * self.resonance):
            moved = self._gains(model.dynamics, frequency_hz, sample_time_s, factor)
            worst = np.maximum(worst, np.abs(moved / response - 1.0))
        return np.asarray(delta + worst)

    @staticmethod
    def _gains(dynamics: AxesDynamics, frequency_hz: Array, sample_time_s: float, factor: float) -> Complex:
        """Response (frequency, output) of every axis with its resonance multiplied by a factor."""
        axes = tuple(
            axis.model_copy(update={"resonance_hz": factor * axis.resonance_hz})
            if axis.resonance_hz
            else axis
            for axis in dynamics.axes
        )
        return _diagonal(discretise(dynamics.model_copy(update={"axes": axes}), sample_time_s), frequency_hz)

    @staticmethod
    def share(delta: Array) -> Array:
        """Part Q of an error that is learnt, where the model is as uncertain as this."""
        return np.asarray(np.clip((1.0 - delta) / (1.0 - SURE), 0.0, 1.0))


def _diagonal(block: LinearBlock, frequency_hz: Array) -> Complex:
    """Response (frequency, output) of each output to its own input."""
    return np.asarray(np.diagonal(block.response(frequency_hz), axis1=1, axis2=2))
