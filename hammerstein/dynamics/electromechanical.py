"""A voltage-driven piezo stack from the numbers of its data sheet: hysteresis between voltage and charge."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hammerstein.arrays import Array
from hammerstein.dynamics.feedback_block import FeedbackBlock
from hammerstein.dynamics.linear_block import CONTINUOUS
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.quantities import Delay, Range
from hammerstein.validation import Strict

Positive = Annotated[float, Range(1e-12, 1e12)]
NotNegative = Annotated[float, Range(0.0, 1e12)]


class ElastoSlip(Strict):
    """One stop operator of the charge: V = k (q - p(q)), p the play with this threshold."""

    stiffness_v_per_uc: Positive = Field(description="k: voltage for each uC before it slips")
    threshold_uc: Positive = Field(description="charge at which it slips")


class StackAxis(Strict):
    """One stack that moves one axis.

        u = V_h(q) + V_z,    q = C V_z + T x,    M x'' + D x' + K x = T V_z

    V_h is the sum of the stops. Symbols of a data sheet: M effective mass, K stiffness with what it drives,
    D damping, C small-signal capacitance of the clamped stack, T blocking force for each volt.
    """

    mass_kg: Positive
    stiffness_n_per_um: Positive
    damping_ns_per_m: NotNegative = 0.0
    capacitance_uf: Positive
    force_n_per_v: Positive = Field(description="T; the same number in uC/um")
    stops: tuple[ElastoSlip, ...] = ()

    @model_validator(mode="after")
    def _stops_differ(self) -> Self:
        if len({stop.threshold_uc for stop in self.stops}) < len(self.stops):
            raise ValueError("two stops have the same threshold; add their stiffnesses")
        return self

    @property
    def resonance_hz(self) -> float:
        """Resonance of the shorted stack without hysteresis [Hz]."""
        return float(np.sqrt(1e6 * self.stiffness_n_per_um / self.mass_kg) / (2.0 * np.pi))

    def charge(self) -> Pair:
        """Plays of s = C u + T x whose sum is the charge q.

        With u and x given, q + C V_h(q) = s. The left side is a Prandtl-Ishlinskii operator with slopes that
        fall to 1. Its inverse is therefore also one, and there is no algebraic loop (Krejci and Kuhnen, IEE
        Proc. Control Theory Appl. 148(3), 2001).
        """
        stops = sorted(self.stops, key=lambda stop: stop.threshold_uc)
        r = np.array([0.0, *(stop.threshold_uc for stop in stops)])
        soft = self.capacitance_uf * np.array([stop.stiffness_v_per_uc for stop in stops])
        slopes = 1.0 + soft.sum() - np.concatenate([[0.0], np.cumsum(soft)])
        reached = np.concatenate([[0.0], np.cumsum(slopes[:-1] * np.diff(r))])
        return Pair(reached, np.diff(1.0 / slopes, prepend=0.0))

    def matrices(self) -> tuple[Array, Array, Array, Array]:
        """A and E of (x, x' / w), F and G of s; w is the charge."""
        w, t, c = 2.0 * np.pi * self.resonance_hz, self.force_n_per_v, self.capacitance_uf
        compliance = w / self.stiffness_n_per_um
        a = np.array([[0.0, w], [-w - compliance * t * t / c, -self.damping_ns_per_m / self.mass_kg]])
        return a, np.array([[0.0], [compliance * t / c]]), np.array([[t, 0.0]]), np.array([[c]])


class ElectromechanicalDynamics(Strict):
    """Stacks driven by voltage, hysteresis between voltage and charge; one axis each, not coupled.

    Source: M. Goldfarb and N. Celanovic, "Modeling piezoelectric stack actuators for control of
    micromanipulation", IEEE Control Systems 17(3), 1997, equations 1 to 6.
    """

    kind: Literal["electromechanical"] = "electromechanical"
    axes: tuple[StackAxis, ...] = Field(min_length=1)
    input_delay_s: Delay = 0.0

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return len(self.axes)

    def describe(self) -> str:
        """Short description."""
        each = ", ".join(f"{axis.resonance_hz:.4g} Hz with {len(axis.stops)} stops" for axis in self.axes)
        return f"electromechanical stacks: {each}"

    def block(self) -> FeedbackBlock:
        """Return its matrices, in continuous time."""
        n, each = len(self.axes), [axis.matrices() for axis in self.axes]
        a, e, f, g = (np.zeros((rows * n, columns * n)) for rows, columns in ((2, 2), (2, 1), (1, 2), (1, 1)))
        for i, (own_a, own_e, own_f, own_g) in enumerate(each):
            a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], e[2 * i : 2 * i + 2, i : i + 1] = own_a, own_e
            f[i : i + 1, 2 * i : 2 * i + 2], g[i, i] = own_f, own_g[0, 0]
        c = np.asarray(np.kron(np.eye(n), [[1.0, 0.0]]), dtype=np.float64)
        none = Pair(np.zeros(1), np.zeros(1))
        charges = [axis.charge() for axis in self.axes]
        pairs = tuple(tuple(charges[i] if i == k else none for k in range(n)) for i in range(n))
        b, d, gamma = np.zeros((2 * n, n)), np.zeros((n, n)), PrandtlIshlinskii(pairs)
        return FeedbackBlock(a, b, c, d, e, f, g, gamma, CONTINUOUS)
