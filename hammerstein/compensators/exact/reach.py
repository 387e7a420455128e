"""What a drive range can reach, and what of a path it could not."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hammerstein.blocks import Array, Law, checked_reference
from hammerstein.compensators.exact.inverse import ExactInverse
from hammerstein.dynamics import discretise
from hammerstein.errors import SimulationError
from hammerstein.model import HammersteinModel

STROKE_SAMPLES = 50
BISECTIONS = 40
MISSED_UM = 1e-6


@dataclass(frozen=True, eq=False)
class Reach:
    """Largest slow movements about zero that the drive's range allows.

    alone_um : (p,) amplitude of each output while the others are held at zero
    together_um : (p,) amplitudes of all outputs at once, in the proportion of ``alone_um``, of any signs
    """

    alone_um: Array
    together_um: Array

    def statement(self, names: Sequence[str]) -> str:
        """Say the reach of each output and of all together."""
        alone, together = (
            ", ".join(f"{name} +-{a:.4g}" for name, a in zip(names, values, strict=True))
            for values in (self.alone_um, self.together_um)
        )
        return f"Reach at low frequency: one at a time {alone} um; all at once {together} um."


def reach(model: HammersteinModel, range_v: float, *, run_anyway: bool = False) -> Reach:
    """Reach of the static block, found by driving the exact inverse to and fro until it stands at the range.

    Dynamics are left out: at low frequency the displacement is that of the static block, near a resonance
    the drive reaches further.

    Raises
    ------
    InputError, SimulationError : as ``ExactInverse`` for a model without an inverse

    Examples
    --------
    >>> from hammerstein.dynamics.models import StaticDynamics
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> plant = PrandtlIshlinskii([[Pair([0.0, 1.0], [4.0, 2.0])]])
    >>> model = HammersteinModel("one axis", plant, StaticDynamics(n_outputs=1), 10.0, ("u",), ("y",))
    >>> reach(model, 10.0).alone_um.round(6)
    array([58.])
    """
    p = model.hysteresis.n_outputs
    if math.isinf(range_v):
        return Reach(np.full(p, np.inf), np.full(p, np.inf))
    law = ExactInverse(model, range_v, run_anyway=run_anyway)
    most = float(np.abs(model.hysteresis.gain(range_v)).sum()) * range_v
    alone = np.array([most * _largest(_strokes_fit(law, [most * row])) for row in np.eye(p)])
    corners = [alone * np.array((1, *signs)) for signs in itertools.product((1, -1), repeat=p - 1)]
    return Reach(alone, alone * _largest(_strokes_fit(law, corners)))


def largest_scale(law: Law[Any], path_um: ArrayLike, range_v: float) -> float:
    """Largest factor, up to 1, for a path (p, N) with which the drive stays within its range."""
    path = checked_reference(path_um, law.n_outputs)

    def fits(scale: float) -> bool:
        return bool(np.abs(law.drive_for(scale * path)).max() < range_v)

    return 1.0 if fits(1.0) else _largest(fits)


def _largest(fits: Callable[[float], bool]) -> float:
    """Largest number from 0 to 1 that fits, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _strokes_fit(law: ExactInverse, tips_um: Sequence[Array]) -> Callable[[float], bool]:
    """Whether a factor times each tip (p,), and its negative, can be reached again and again."""
    wave = np.sin(0.5 * np.pi * np.arange(10 * STROKE_SAMPLES + 1) / STROKE_SAMPLES)

    def fits(scale: float) -> bool:
        paths = (scale * np.outer(tip, wave) for tip in tips_um)
        return all(bool((np.abs(law.drive_for(path)) < law.range_v).all()) for path in paths)

    return fits


@dataclass(frozen=True, eq=False)
class Shortfall:
    """Where a drive would leave its path, as the model predicts it.

    predicted_um, error_um : (p, N) position and its distance from the path [um]
    at_range : (m, N) where the drive stands at its range
    sample_time_s : time between samples [s]
    turn : output and sample where the path changes its velocity most
    """

    predicted_um: Array
    error_um: Array
    at_range: NDArray[np.bool_]
    sample_time_s: float
    turn: tuple[int, int]

    def missed(self, tolerance_um: float = MISSED_UM) -> NDArray[np.bool_]:
        """Samples (p, N) whose predicted error is larger than a tolerance."""
        return np.abs(self.error_um) > tolerance_um

    @property
    def complete(self) -> bool:
        """True if the drive never stands at its range."""
        return not self.at_range.any()

    def statement(self, inputs: Sequence[str], outputs: Sequence[str]) -> str:
        """Say how often each input stands at its range, and how far each output is missed."""
        if self.complete:
            worst = ", ".join(f"{n} {e:.3g}" for n, e in zip(outputs, self._worst(), strict=True))
            return f"The drive stays within its range; predicted errors up to {worst} um."
        parts = []
        for name, row in zip(inputs, self.at_range, strict=True):
            if row.any():
                first = int(np.argmax(row))
                parts.append(
                    f"input {name} stands at its range in {int(row.sum())} of {len(row)} samples, first at "
                    f"sample {first} ({first * self.sample_time_s:.4g} s)"
                )
        for name, row, worst_um in zip(outputs, self.error_um, self._worst(), strict=True):
            where = int(np.argmax(np.abs(row)))
            parts.append(f"output {name} is missed by up to {worst_um:.4g} um (sample {where})")
        axis, sample = self.turn
        return "; ".join(parts) + (
            f". The path turns hardest at sample {sample} of {outputs[axis]}; where it has a corner or a "
            "jump, set filter_hz, start it smoothly, or make it smaller."
        )

    def _worst(self) -> list[float]:
        return [float(e) for e in np.abs(self.error_um).max(axis=1)]


def shortfall(
    model: HammersteinModel,
    law: Law[Any],
    reference_um: ArrayLike,
    drive_v: Array,
    range_v: float,
    sample_time_s: float,
) -> Shortfall:
    """Predict with the model where a drive leaves its path.

    Parameters
    ----------
    model : the model that the law was built from, dynamics included
    law : the law that gave the drive; a delay it states (``delay_samples``) is not counted as an error
    reference_um : (p, N) path [um]
    drive_v : (m, N) what the law gave [V]
    range_v, sample_time_s : of the drive
    """
    reference = checked_reference(reference_um, law.n_outputs)
    position, _ = discretise(model.dynamics, sample_time_s).respond(model.hysteresis.respond(drive_v)[0])
    delay = int(getattr(law, "delay_samples", 0))
    asked = np.pad(reference, ((0, 0), (delay, 0)))[:, : reference.shape[1]]
    bends = np.zeros(reference.shape)
    bends[:, 1:-1] = np.abs(np.diff(reference, 2, axis=1))
    axis, sample = np.unravel_index(int(np.argmax(bends)), bends.shape)
    at_range = np.abs(drive_v) >= range_v * (1.0 - 1e-12)
    return Shortfall(position, position - asked, at_range, sample_time_s, (int(axis), int(sample)))


def require_reach(found: Shortfall, inputs: Sequence[str], outputs: Sequence[str]) -> None:
    """Raise SimulationError with the statement unless the drive stays within its range."""
    if not found.complete:
        raise SimulationError(f"The path is out of reach: {found.statement(inputs, outputs)}")
