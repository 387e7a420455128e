"""One axis during its fit: what stays fixed, and the paths that its parameters make."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from hammerstein.dynamics import Axis, CreepMode, LinearBlock
from hammerstein.identification.static.normal_equations import Moments, moments_of, pooled
from hammerstein.identification.static.regressors import Filter, Start, delayed, regressor_blocks
from hammerstein.records.record import Record

Array = NDArray[np.float64]

STEP = 1e-5
"""Change of a parameter for its derivative: the parameters are logarithms and relative gains."""


@dataclass(frozen=True, eq=False)
class Heard:
    """A linear block that hears one sum of all columns."""

    weights: Array
    block: LinearBlock

    def rest(self) -> Array:
        """State of a block that was never driven."""
        return self.block.rest()

    def respond(self, columns: Array, start: Array) -> tuple[Array, Array]:
        """Outputs (row, sample) and the state after them."""
        return self.block.respond(self.weights @ columns, start)


@dataclass(frozen=True, eq=False)
class AxisTask:
    """What stays fixed while one axis is fitted."""

    records: tuple[Record, ...]
    starts: tuple[Start, ...]
    grids: tuple[Array, ...]
    output: int
    creep_modes: int
    delay_samples: int
    sensor_bandwidth_hz: float | None

    @property
    def columns(self) -> int:
        """Slope columns of all inputs."""
        return sum(map(len, self.grids))

    @property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest parameters that records of this length and rate can tell anything of."""
        step = min(record.sample_time_s for record in self.records)
        span = duration_s(self.records)
        lower = [math.log(0.2 / span), math.log(1e-4), *self.creep_modes * (-1.0, math.log(10.0 * step))]
        upper = [math.log(0.45 / step), math.log(10.0), *self.creep_modes * (10.0, math.log(10.0 * span))]
        return np.array(lower), np.array(upper)

    def path(self, x: Array, sample_time_s: float) -> LinearBlock:
        """Discrete path from the static block to the reading: what ``discretise`` gives, but quickly."""
        a, b, c = axis_matrices(x)
        if self.sensor_bandwidth_hz is not None:
            s = 2.0 * math.pi * self.sensor_bandwidth_hz
            a = np.block([[a, np.zeros((len(a), 1))], [s * c, np.full((1, 1), -s)]])
            b = np.vstack([b, np.zeros((1, 1))])
            c = np.eye(len(a))[-1:]
        return held(a, b, c, np.zeros((1, 1)), sample_time_s)

    def sensor(self, sample_time_s: float) -> LinearBlock:
        """Discrete path of an axis without dynamics: the sensor alone."""
        one = np.ones((1, 1))
        if self.sensor_bandwidth_hz is None:
            none = np.empty((0, 0))
            return LinearBlock(none, np.empty((0, 1)), np.empty((1, 0)), one, sample_time_s)
        s = 2.0 * math.pi * self.sensor_bandwidth_hz * one
        return held(-s, s, one, 0.0 * one, sample_time_s)

    def derivatives(self, x: Array, slopes: Array, sample_time_s: float) -> Heard:
        """Derivatives of the output by every x_i, for the static block with these slopes."""
        blocks = []
        for change in STEP * np.eye(len(x)):
            ahead, behind = self.path(x + change, sample_time_s), self.path(x - change, sample_time_s)
            blocks += [(ahead, 0.5 / STEP), (behind, -0.5 / STEP)]
        rows = np.kron(np.eye(len(x)), np.ones((1, 2)))
        signed = [factor * block.C for block, factor in blocks]
        through = [factor * block.D for block, factor in blocks]
        return Heard(
            slopes,
            LinearBlock(
                block_diag(*(block.A for block, _ in blocks)),
                np.vstack([block.B for block, _ in blocks]),
                rows @ block_diag(*signed),
                np.asarray(rows @ np.vstack(through)),
                sample_time_s,
            ),
        )

    def moments(self, filters: Callable[[float], Sequence[Filter]], columns: int) -> Moments:
        """Moments of the columns with the output over all records; the filters depend on the sample time."""
        times = {record.sample_time_s for record in self.records}
        built = {time: filters(time) for time in times}
        parts = []
        for record, start in zip(self.records, self.starts, strict=True):
            y, passed = record.y_um[[self.output]], built[record.sample_time_s]
            blocks = regressor_blocks(delayed(record, start, self.delay_samples), start, self.grids, passed)
            parts.append(moments_of(((c, y[:, k : k + c.shape[1]]) for k, c in blocks), columns, 1))
        return pooled(parts)


def duration_s(records: Sequence[Record]) -> float:
    """Time of the longest record [s]."""
    return max(record.sample_time_s * record.samples for record in records)


def axis_matrices(x: Array) -> tuple[Array, Array, Array]:
    """Continuous A, B, C of an axis with its creep: states position, speed / w, one for each slow mode."""
    w, damping = 2.0 * math.pi * math.exp(x[0]), math.exp(x[1])
    gains, rates = x[2::2], np.exp(-x[3::2])
    n = 2 + len(gains)
    a, b, c = np.zeros((n, n)), np.zeros((n, 1)), np.zeros((1, n))
    a[:2, :2] = [[0.0, w], [-w, -2.0 * damping * w]]
    a[2:, 0] = rates
    a[range(2, n), range(2, n)] = -rates
    b[1] = w
    c[0, 0] = 1.0
    c[0, 2:] = gains
    return a, b, c


def held(a: Array, b: Array, c: Array, d: Array, sample_time_s: float) -> LinearBlock:
    """Block on a sample grid, exact for an input held over each sample: exponential of [[A, B], [0, 0]] T.

    Examples
    --------
    >>> one = np.ones((1, 1))
    >>> abs(float(held(-one, one, one, 0.0 * one, 1.0).A[0, 0]) - math.exp(-1.0)) < 1e-15
    True
    """
    n, m = b.shape
    full = np.zeros((n + m, n + m))
    full[:n, :n], full[:n, n:] = a * sample_time_s, b * sample_time_s
    result = expm(full)
    return LinearBlock(result[:n, :n], result[:n, n:], c, d, sample_time_s)


def axis_of(x: Array) -> Axis:
    """Axis with the parameters (ln resonance, ln damping, gain and ln time constant of each creep mode)."""
    slow = tuple(CreepMode(gain=float(g), time_constant_s=math.exp(t)) for g, t in x[2:].reshape(-1, 2))
    return Axis(resonance_hz=math.exp(x[0]), damping_ratio=math.exp(x[1]), creep=slow)
