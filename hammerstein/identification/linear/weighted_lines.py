"""What a linear model is fitted to: responses at points of the unit circle, scaled, warped and weighted."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from hammerstein.arrays import Array, Complex, transfer
from hammerstein.errors import IdentificationError
from hammerstein.identification.linear.frequency_response import FrequencyResponse

Weighting = Literal["power", "variance"]

CHUNK = 4096
"""Lines handled at a time, which bounds the memory for long records."""

SPREAD = 0.9
"""Part of the half circle over which the warping spreads a band that is narrow against the sample rate."""

NEIGHBOURS = 5
"""Lines on either side over which a variance from few experiments is averaged before it becomes a weight."""


class Matrices(NamedTuple):
    """A (n, n), B (n, m), C (p, n), D (p, m) of x+ = A x + B u, y = C x + D u."""

    A: Array
    B: Array
    C: Array
    D: Array

    def at(self, z: Complex) -> Complex:
        """Response (F, p, m) at the points z (F,)."""
        return transfer(self.A, self.B, self.C, self.D, z)


@dataclass(frozen=True, eq=False)
class WeightedLines:
    """Data of the least-squares problem.

        minimise over A, B, C, D:   sum over k of | left_k (C (z_k - A)^-1 B + D - target_k) right_k |^2

    z : (F,) points on the unit circle, after the warping
    target : (F, p, m) measured response, inputs and outputs scaled to unit size
    left : (F, p) weight of each output
    right : (F, m, m) factor of the input power: with it the sum is that of output errors in the experiment
    floor : contribution of noise and distortion to the sum, for any model
    total : the sum for the model G = 0, floor included
    input_scale, output_scale : (m,), (p,) units of ``target``
    warp : factor a of the warping
    """

    z: Complex
    target: Complex
    left: Array
    right: Complex
    floor: float
    total: float
    input_scale: Array
    output_scale: Array
    warp: float

    def chunks(self) -> Iterator[slice]:
        """Slices that cover all lines."""
        return (slice(i, i + CHUNK) for i in range(0, len(self.z), CHUNK))

    def cost(self, model: Matrices) -> float:
        """Sum of squares that a model leaves of the target."""
        total = 0.0
        for k in self.chunks():
            error = self.left[k, :, None] * ((model.at(self.z[k]) - self.target[k]) @ self.right[k])
            total += float(np.sum(error.real**2 + error.imag**2))
        return total

    def percent(self, cost: float) -> float:
        """Error left by a fit of this cost, noise and distortion included, in % of the output [%]."""
        return 100.0 * math.sqrt((cost + self.floor) / self.total)

    def physical(self, model: Matrices) -> Matrices:
        """Undo warping and scaling of a model fitted to these lines.

        With z' = (z - a) / (1 - a z) and M = 1 + a A', C' (z' - A')^-1 B' + D' equals
        C (z - A)^-1 B + D for A = M^-1 (A' + a), B = M^-1 B', C = C' (1 - a A), D = D' - a C' M^-1 B'.
        """
        a, eye = self.warp, np.eye(len(model.A))
        mixed = eye + a * model.A
        A = np.asarray(np.linalg.solve(mixed, model.A + a * eye), dtype=np.float64)
        B = np.linalg.solve(mixed, model.B) / self.input_scale
        C = self.output_scale[:, None] * (model.C @ (eye - a * A))
        D = self.output_scale[:, None] * (model.D / self.input_scale - a * model.C @ B)
        return Matrices(A, B, C, D)


def weigh(response: FrequencyResponse, weighting: Weighting) -> WeightedLines:
    """Scale, warp and weigh a measured response.

    The warping z' = (z - a) / (1 - a z) maps the unit circle and the stable poles onto themselves and spreads
    a band far below the Nyquist frequency over the circle. Powers of z' then differ from each other
    where those of z are nearly equal, which keeps the subspace method well conditioned.

    Raises
    ------
    IdentificationError : an output without any response; weights asked from a variance that is not known
    """
    power = np.ascontiguousarray(response.input_power.transpose(2, 0, 1))
    output = response.output_power.T
    dead = np.flatnonzero(output.max(axis=0) == 0.0)
    if dead.size:
        raise IdentificationError(f"output {dead[0] + 1} does not respond at any line: remove it")
    input_scale = np.sqrt(np.diagonal(power, axis1=1, axis2=2).real.mean(axis=0))
    output_scale = np.sqrt(output.mean(axis=0))
    left = _weights(response, weighting) * output_scale
    scaled = left / output_scale  # weight of an output in its own unit
    right = np.linalg.cholesky(power) / input_scale[:, None]
    z: Complex = np.exp(2j * np.pi * response.frequency_hz * response.sample_time_s)
    warp = _warp(float(np.angle(z).max()))
    return WeightedLines(
        z=(z - warp) / (1.0 - warp * z),
        target=response.response.transpose(2, 0, 1) * input_scale / output_scale[:, None],
        left=left,
        right=right,
        floor=float(np.sum(scaled**2 * response.residual_power.T)),
        total=float(np.sum(scaled**2 * output)),
        input_scale=input_scale,
        output_scale=output_scale,
        warp=warp,
    )


def _weights(response: FrequencyResponse, weighting: Weighting) -> Array:
    """Weight (F, p) of each output at each line [1 / output]."""
    if weighting == "power":
        return np.broadcast_to(1.0 / np.sqrt(response.output_power.mean(axis=1)), response.coherence.T.shape)
    residue = response.residual_power.T
    if response.variance is None or not residue.any(axis=0).all():
        raise IdentificationError(
            "the variance of the response is unknown, so it cannot weight the fit: use more "
            "experiments than inputs or several periods, or choose the weighting 'power'"
        )
    return np.asarray(1.0 / np.sqrt(uniform_filter1d(residue, 2 * NEIGHBOURS + 1, axis=0, mode="nearest")))


def _warp(angle: float) -> float:
    """Factor a of the warping that moves the highest line to ``SPREAD`` of the half circle."""
    warp = math.tan(0.5 * math.pi * SPREAD) / math.tan(0.5 * angle)
    return max(0.0, (warp - 1.0) / (warp + 1.0))
