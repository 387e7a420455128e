"""A kind of hysteresis from outside the package: Duhem's, whose slope is any function of where it stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import hammerstein
from hammerstein.blocks import Memory

STEPS = 4
"""Steps of the midpoint rule between two samples."""


@dataclass(frozen=True, eq=False)
class Standing(Memory):
    """Where it stands: the last input, and the output."""

    z: np.ndarray
    w: np.ndarray


@dataclass(frozen=True, eq=False)
class Duhem(hammerstein.Hysteresis):
    """dw = f(w) dz while z grows, f(-w) dz while it falls; f is straight between knots from -reach to reach.

    Beyond the outer knots f goes on for one step of the grid, and is constant then.

    Source: Duhem, Z. Phys. Chem. 22 (1897); Visintin, Differential Models of Hysteresis (Springer, 1994).
    """

    kind = "duhem"
    slopes: tuple[float, ...]
    reach: float
    n_inputs = n_outputs = 1
    operators = ((1,),)
    weight_covariance = None
    weights = (np.ones(1),)

    @property
    def n_beside_weights(self):
        return len(self.slopes)

    @property
    def free(self):
        return np.array(self.slopes)

    def at(self, free):
        return replace(self, slopes=tuple(free.tolist()))

    def with_weights(self, weights):
        return self

    def describe(self):
        return f"Duhem, {len(self.slopes)} knots"

    def rest(self):
        return Standing(np.zeros(1), np.zeros(1))

    def file(self):
        raise NotImplementedError("it is tried beside the package, and has no file")

    def _slope(self, w):
        last = len(self.slopes) - 1
        place = min(last + 1.0, max(-1.0, 0.5 * (w / self.reach + 1.0) * last))
        left = min(max(int(place), 0), last - 1)
        low, high = self.slopes[left], self.slopes[left + 1]
        return low + (high - low) * (place - left)

    def step(self, u_v, state):
        z, w = float(u_v[0]), float(state.w[0])
        part = (z - float(state.z[0])) / STEPS
        way = 1.0 if part > 0.0 else -1.0
        for _ in range(STEPS):
            middle = w + 0.5 * part * self._slope(way * w)
            w += part * self._slope(way * middle)
        now = np.array([w])
        return now, Standing(np.array([z]), now)

    def _respond(self, u_v, start):
        out, state = np.empty((1, u_v.shape[1])), start
        for k in range(u_v.shape[1]):
            out[:, k], state = self.step(u_v[:, k], state)
        return out, state
