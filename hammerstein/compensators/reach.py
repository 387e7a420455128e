"""Reach of a drive range, and the part of a path beyond it."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, Flags
from hammerstein.blocks import Law, checked_reference
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.exact.inverse import exact_inverse_of, has_exact_inverse
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.dynamics import WithLoop, on_grid
from hammerstein.hysteresis.kind import SLOW_S
from hammerstein.model import HammersteinModel

STROKE_SAMPLES = 50  # of a quarter of a cycle
BISECTIONS = 40  # part of the reach: 2^-40
MISSED_UM = 1e-6  # rounding error of a path within reach
MISSED_SHARE = 0.01  # of the largest error; outputs with less are not named
ROUGH_BISECTIONS = 14
"""Bisections with a law without inverse, which is slow; its error exceeds that of a finer search."""
PASSES = 4
"""Iterations of that law per sample."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Positions that slow paths can reach repeatedly, relative to the initial position.

    alone_um : (p, 2) lowest and highest position of each output while the others are at mid-range
    together_um : (p, 2) the same for all outputs at once, in the proportion of ``alone_um``
    """

    alone_um: Array
    together_um: Array

    def statement(self, names: Sequence[str]) -> str:
        """State the reach of each output and of all together."""

        def told(ends_um: Array) -> str:
            each = zip(names, np.where(np.abs(ends_um) < MISSED_UM, 0.0, ends_um), strict=True)  # 0: rounding
            return ", ".join(f"{name} {low:.4g} to {high:.4g}" for name, (low, high) in each)

        alone = told(self.alone_um)
        if len(names) == 1:
            return f"Reach of slow paths from the initial position: {alone} um."
        return (
            f"Reach of slow paths, one axis at a time with the others at mid-range: {alone} um; "
            f"all axes together {told(self.together_um)} um."
        )


def reach(model: HammersteinModel, range_v: RangeLike, *, run_anyway: bool = False) -> Reach:
    """Reach of the static block within a drive range.

    The model is driven once to both ends of the range and back, which gives the centre of its loop. About
    this centre, the exact inverse alternates with growing amplitude until it reaches the range, which
    includes losses by cross-coupling. Kinds without exact inverse use the paper's law with several
    iterations. Dynamics with hysteresis in their loop use the gains of slow loops. Other dynamics are
    ignored: at low frequency, the static block determines the displacement; near a resonance, the reach is
    larger.

    Parameters
    ----------
    model : m inputs, p <= m outputs
    range_v : range of the drive [V], see ``DriveRange.of``
    run_anyway : accept a model without an inverse

    Raises
    ------
    InputError, SimulationError : as the law for a model without an inverse

    Examples
    --------
    >>> from hammerstein.dynamics.models import StaticDynamics
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> plant = PrandtlIshlinskii([[Pair([0.0, 1.0], [4.0, 2.0])]])
    >>> model = HammersteinModel("one axis", plant, StaticDynamics(n_outputs=1), 10.0, ("u",), ("y",))
    >>> reach(model, 10.0).alone_um.round(6), reach(model, (0.0, 20.0)).alone_um.round(6)
    (array([[-58.,  58.]]), array([[  2., 118.]]))
    """
    limits = DriveRange.of(range_v, model)
    p = len(model.outputs)
    if not np.isfinite(limits.span_v).all():
        nowhere = np.tile([-np.inf, np.inf], (p, 1))
        return Reach(nowhere, nowhere)
    if isinstance(model.dynamics, WithLoop):
        return _reach_of_loop(model, limits)
    model = model.on_grid(SLOW_S)  # how far it gets when nothing hurries
    middle = 0.5 * (limits.low_v + limits.high_v)
    about = replace(limits, working_point_v=middle, start_v=middle, conditioned=False)
    counted = model.hysteresis.counted_from(middle)
    if has_exact_inverse(counted):
        law: Law[Any] = exact_inverse_of(counted, model, about, 0.0, run_anyway)
        bisections = BISECTIONS
    else:  # the law of the paper, with so many passes that it is as good as an inverse
        law = InverseMultiplicativeLaw(model, about, SLOW_S, iterations=PASSES, run_anyway=run_anyway)
        bisections = ROUGH_BISECTIONS
    between = _centre(model, about)[:, None]
    half = 0.5 * limits.span_v
    most = float(np.abs(counted.amplitude(half)).sum()) * len(half)
    each = most * np.eye(p)
    alone = np.array([most * _largest(law, bisections, between, [row]) for row in each])
    corners = [alone * np.array((1, *signs)) for signs in itertools.product((1, -1), repeat=p - 1)]
    together = alone * _largest(law, bisections, between, corners)
    centre = _centre(model, limits)[:, None]
    return Reach(*(centre + np.stack([-size, size], axis=1) for size in (alone, together)))


def _reach_of_loop(model: HammersteinModel, limits: DriveRange) -> Reach:
    """Reach by the gains of slow loops over the whole range, in which the hysteresis in the loop works."""
    half = 0.5 * limits.span_v
    gain = model.amplitude(half) / half
    needed = np.abs(np.linalg.pinv(gain)) / half[:, None]
    alone = 1.0 / needed.max(axis=0)
    together = alone / (needed @ alone).max()
    centre = gain @ (0.5 * (limits.low_v + limits.high_v) - limits.start_v)
    return Reach(*(np.stack([centre - size, centre + size], axis=1) for size in (alone, together)))


def _centre(model: HammersteinModel, limits: DriveRange) -> Array:
    """Middle (p,) between the tips of the loop, counted from the start [um]."""
    low, high = limits.counted
    before = limits.history()
    hysteresis = model.hysteresis.counted_from(limits.working_point_v)
    v, _ = hysteresis.respond(np.hstack([before, np.stack([high, low, high], axis=1)]))
    return np.asarray(0.5 * (v[:, -2] + v[:, -1]) - v[:, before.shape[1] - 1])


def _inside(law: Law[Any], path_um: Array) -> bool:
    """Whether the drive of a path (p, N) never stands at its range; the first cycle tells most that do."""
    limits, cycle = law.range, 4 * STROKE_SAMPLES
    state, coming = law.primed(path_um)
    for first in range(0, coming.shape[1], cycle):
        drive, state = law.respond(coming[:, first : first + cycle], state)
        if not ((drive < limits.high_v[:, None]) & (drive > limits.low_v[:, None])).all():
            return False
    return True


def _largest(law: Law[Any], bisections: int, middle_um: Array, tips_um: Sequence[Array]) -> float:
    """Largest factor up to 1 with which each tip (p,) and its negative are reached about a middle (p, 1)."""
    wave = np.sin(0.5 * np.pi * np.arange(10 * STROKE_SAMPLES + 1) / STROKE_SAMPLES)
    low, high = 0.0, 1.0
    for _ in range(bisections):
        scale = 0.5 * (low + high)
        fits = all(_inside(law, middle_um + scale * np.outer(tip, wave)) for tip in tips_um)
        low, high = (scale, high) if fits else (low, scale)
    return low


@dataclass(frozen=True, eq=False)
class Shortfall:
    """Predicted deviation of a drive from its path.

    predicted_um, error_um : (p, N) position and its distance from the path [um]
    at_range : (m, N) whether the drive is at its range; limits : that range
    at_low : (m,) whether it is at the lower end more often
    sample_time_s : time between samples [s]
    turn : output and sample with the largest change of velocity
    """

    predicted_um: Array
    error_um: Array
    at_range: Flags
    sample_time_s: float
    turn: tuple[int, int]
    limits: DriveRange
    at_low: Flags

    @property
    def complete(self) -> bool:
        """True if the drive is never at its limit."""
        return not self.at_range.any()

    def statement(self, inputs: Sequence[str], outputs: Sequence[str], lead: int = 0) -> str:
        """Samples of each input at its limit, and largest error of each output, in words.

        lead : samples before the path, which do not belong to its time
        """
        parts = []
        for k, (name, row) in enumerate(zip(inputs, self.at_range, strict=True)):
            if row.any():
                first = int(np.argmax(row))
                end, volts = ("lower", self.limits.low_v) if self.at_low[k] else ("upper", self.limits.high_v)
                parts.append(
                    f"input {name} is at its {end} limit, {volts[k]:.6g} V, in {int(row.sum())} of "
                    f"{len(row)} samples, first {self.when(first, lead)}"
                )
        for name, row, worst_um in zip(outputs, self.error_um, self._worst(), strict=True):
            if worst_um > MISSED_SHARE * max(self._worst()):
                when = self.when(int(np.argmax(np.abs(row))), lead)
                parts.append(f"output {name} has an error of up to {worst_um:.4g} um {when}")
        axis, sample = self.turn
        when = self.when(sample, lead)
        return f"{'; '.join(parts)}. The largest acceleration is {when} on {outputs[axis]}."

    def when(self, sample: int, lead: int) -> str:
        """Time of a sample, counted from the beginning of the path."""
        return "in the lead-in" if sample < lead else f"at {(sample - lead) * self.sample_time_s:.4g} s"

    def _worst(self) -> list[float]:
        return [float(e) for e in np.abs(self.error_um).max(axis=1)]


def shortfall(
    model: HammersteinModel,
    law: Law[Any],
    reference_um: ArrayLike,
    asked_v: Array,
    sample_time_s: float,
    sent_v: Array | None = None,
) -> Shortfall:
    """Predict the deviation of a drive from its path.

    Parameters
    ----------
    model : the model that the law was built from, dynamics included
    law : the law of the drive; a delay that it states (``delay_samples``) is no error
    reference_um : (p, N) path, relative to the initial position [um]
    asked_v : (m, N) voltages of the law [V]
    sample_time_s : of the drive
    sent_v : (m, N) the same on the steps of the converter; the same if not given
    """
    reference = checked_reference(reference_um, law.n_outputs)
    sent = asked_v if sent_v is None else sent_v
    model = model.on_grid(sample_time_s)
    before, memory = model.hysteresis.standing(law.range.history())
    v, _ = model.static_response(sent, memory)
    position, _ = on_grid(model.dynamics, sample_time_s).respond(v - before[:, None])
    delay = law.delay_samples
    asked = np.pad(reference, ((0, 0), (delay, 0)))[:, : reference.shape[1]]
    bends = np.zeros(reference.shape)
    bends[:, 1:-1] = np.abs(np.diff(reference, 2, axis=1))
    axis, sample = np.unravel_index(int(np.argmax(bends)), bends.shape)
    error = position - asked
    # An actuator may stand at an end of the range from the start: there it has missed nothing yet.
    asked_for, _ = model.static_response(asked_v, memory)
    rounding = float(np.abs(v - asked_for).max(initial=0.0))
    missed = (np.abs(error) > MISSED_UM + rounding).any(axis=0)
    at_range = law.range.reached(asked_v) & ((asked_v != law.range.start_v[:, None]) | missed)
    middle = 0.5 * (law.range.low_v + law.range.high_v)[:, None]
    at_low = 2 * (at_range & (asked_v < middle)).sum(axis=1) > at_range.sum(axis=1)
    turn = int(axis), int(sample)
    return Shortfall(position, error, at_range, sample_time_s, turn, law.range, np.asarray(at_low))
