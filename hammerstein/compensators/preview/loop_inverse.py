"""The inverse of dynamics with hysteresis in their loop, in passes of linearisation, known ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law, Memory
from hammerstein.blocks.driving import DriveRange, RangeLike
from hammerstein.compensators.exact.inverse import exact_inverse_of
from hammerstein.compensators.preview.linear_inverse import LinearInverse, block_inverse
from hammerstein.compensators.preview.reference_filter import filtered_by, low_pass_taps
from hammerstein.dynamics import FeedbackBlock, on_grid, split_delay
from hammerstein.dynamics.feedback_hysteresis import FAR_V
from hammerstein.errors import InputError, SimulationError
from hammerstein.model import HammersteinModel

MOST_PASSES = 24
"""Each costs a simulation of the model; strong hysteresis leaves 1e-4 of the path after so many."""
SHARES = (1.0, 0.5, 0.25)
"""Of the range, for the slow loops whose gains are tried."""
TRIAL_SAMPLES = 2000  # of the path on which the passes are tried
TRIAL_PART = 0.3
"""Of the slow reach, for the path on which the passes are tried."""


@dataclass(frozen=True, eq=False)
class LoopPathState(Memory):
    """Memory of the law on a stream.

    raw : (p, samples) references before the filter; path : (p, samples) behind it
    missed : (1 + passes, p, samples) what each pass still inverts; modes : (1 + passes, n_s)
    inputs : (passes, p, samples) of the dynamics, found by each pass; blocks : (passes, numbers) models
    exact : memory of the static inverse
    """

    raw: Array
    path: Array
    missed: Array
    modes: Array
    inputs: Array
    blocks: Array
    exact: Any


class LoopInverseLaw(Law[LoopPathState]):
    """Inverse of a model with hysteresis in the loop of its dynamics, for a path that is known ahead.

        v_0 = G^-1 r,    v_i = v_(i-1) + G^-1 (r - y(v_(i-1))),    U = Gamma_0^-1 v

    y(v) is the model itself, G its linear block with the gains of slow loops over a part of the range
    (``FeedbackBlock.linearised_at``) or of the largest amplitudes, whichever leaves least. Gamma_0 is a
    hysteresis in front of the dynamics. G^-1 is exact on the sample grid (``linear_inverse``). Each pass
    leaves the part of an error by which the slopes of the plays differ from those of G, and looks
    ``reach_samples`` further ahead.

    The actuator starts at rest at its working point. A drive that stands at its range leaves the path, and
    the law does not know.

    Parameters
    ----------
    model : m inputs, p <= m outputs, dynamics with hysteresis in their loop
    range_v : range of the drive [V], see ``DriveRange.of``
    sample_time_s : time between samples [s]
    preview_s : how far ahead the reference is known [s]; as far as needed if not given
    filter_hz, softening_v, run_anyway : as for ``HammersteinInverseLaw``

    Attributes
    ----------
    preview_samples : samples that must be known ahead
    passes, left : how many leave least of a slow path of a third of the reach, and what part of it

    Raises
    ------
    InputError : too little preview, a start away from the working point, and as ``HammersteinInverseLaw``
    SimulationError : no inverse of the linear block, or passes that do not come nearer to the path

    Source: quasi-Newton iteration with a fixed linear model, as in Kelley, Solving Nonlinear Equations with
    Newton's Method (SIAM, 2003), chapter 2 (chord method).
    """

    def __init__(
        self,
        model: HammersteinModel,
        range_v: RangeLike,
        sample_time_s: float,
        preview_s: float | None = None,
        filter_hz: float | None = None,
        softening_v: float = 0.0,
        run_anyway: bool = False,
    ):
        here = model.on_grid(sample_time_s)
        self.exact = exact_inverse_of(here.hysteresis, model, range_v, softening_v, run_anyway)
        self.n_inputs, self.n_outputs = self.exact.n_inputs, self.exact.n_outputs
        self.range, self.origin_um = self.exact.range, self.exact.origin_um
        self.sample_time_s: float = sample_time_s
        if self.range.history().shape[1] > 1:
            raise InputError(
                "start", "hysteresis in the loop is only inverted from rest at the working point"
            )
        delay, late_s = split_delay(model.dynamics.input_delay_s, sample_time_s)
        plain = on_grid(model.dynamics.model_copy(update={"input_delay_s": late_s}), sample_time_s)
        assert isinstance(plain, FeedbackBlock)
        self.block = plain
        self.inverse, self.passes, self.left = self._best(here)
        self.taps = low_pass_taps(filter_hz, sample_time_s)
        ahead = (1 + self.passes) * self.inverse.reach_samples
        self.preview_samples = ahead + len(self.taps) // 2 + delay
        if preview_s is not None and preview_s < self.preview_samples * sample_time_s:
            needed = f"{self.preview_samples * sample_time_s:.3g} s"
            raise InputError("preview_s", f"hysteresis in the loop needs {needed} here, not {preview_s:g}")

    def statement(self) -> str:
        """Say what the law does before a run: passes, preview, start."""
        ahead = self.preview_samples
        return (
            f"{self.exact.invertibility.statement()} The hysteresis in the loop is inverted in "
            f"{self.passes} iterations, with an error of {self.left:.1g} of a slow path. The "
            f"reference must be known {ahead} samples ahead ({ahead * self.sample_time_s:.3g} s) and "
            "start at rest (--lead-in)."
        )

    def rest(self) -> LoopPathState:
        """Actuator at rest, reference at zero until now."""
        p, reach = self.n_outputs, self.inverse.reach_samples
        each = 1 + self.passes
        return LoopPathState(
            np.zeros((p, len(self.taps) - 1)),
            np.zeros((p, self.passes * reach)),
            np.zeros((each, p, reach)),
            np.zeros((each, len(self.inverse.A))),
            np.zeros((self.passes, p, reach)),
            np.tile(self.block.rest(), (self.passes, 1)),
            self.exact.rest(),
        )

    def _respond(self, reference_um: Array, start: LoopPathState) -> tuple[Array, LoopPathState]:
        raw = np.hstack([start.raw, reference_um])
        path = np.hstack([start.path, filtered_by(self.taps, raw)])
        v, after = self._passed(path, start)
        drive, exact, _ = self.exact.solve(self._from_rest(v), start.exact, np.zeros(0))
        samples = reference_um.shape[1]
        return drive, LoopPathState(raw[:, samples:].copy(), path[:, samples:].copy(), *after, exact)

    def _passed(self, path: Array, start: LoopPathState) -> tuple[Array, tuple[Array, Array, Array, Array]]:
        """Inputs (p, N) of the dynamics after all passes, and the parts of the memory that they move."""
        reach = self.inverse.reach_samples
        samples = path.shape[1] - self.passes * reach
        modes, blocks = start.modes.copy(), start.blocks.copy()
        missed, inputs = np.empty_like(start.missed), np.empty_like(start.inputs)
        v = y = np.zeros((self.n_outputs, samples))
        for i in range(1 + self.passes):
            if i:
                y = np.empty((self.n_outputs, samples))
                self.block.carry_on(v, blocks[i - 1], 0, samples, y)
            late = (self.passes - i) * reach  # each pass stands further behind the newest reference
            known = np.hstack([start.missed[i], path[:, late : late + samples] - y])
            change = self.inverse.run(known, modes[i])
            missed[i] = known[:, samples:]
            if i:
                line = np.hstack([start.inputs[i - 1], v])
                inputs[i - 1] = line[:, samples:]
                change += line[:, :samples]
            v = np.ascontiguousarray(change)
        return v, (missed, modes, inputs, blocks)

    def _best(self, model: HammersteinModel) -> tuple[LinearInverse, int, float]:
        """Inverse and number of passes that leave least of a slow path, and that part of it.

        Raises SimulationError where no linear block has an inverse, or all of them lead away from the path.
        """
        half = _half(model, self.range)
        ends = model.hysteresis.amplitude(half).sum(axis=1)
        size = TRIAL_PART * np.abs(model.amplitude(half)).max(axis=1)
        path = size[:, None] * np.sin(np.pi * np.arange(TRIAL_SAMPLES) / TRIAL_SAMPLES) ** 4
        blocks = [self.block.linearised_at(share * ends) for share in SHARES]
        found, refused = [], None
        for linear in (*blocks, self.block.linearised(FAR_V)):
            try:
                inverse = block_inverse(linear)
            except SimulationError as error:
                refused = error
                continue
            found.append((inverse, *self._tried(inverse, path)))
        if not found and refused:
            raise refused
        best = min(found, key=lambda one: one[2])
        if not best[2] < 1.0:
            raise SimulationError(
                "The hysteresis in the loop is too strong for an inverse by iterations: they diverge "
                "on a slow path. Use law none, with feedback or learning around it"
            )
        return best

    def _tried(self, inverse: LinearInverse, path: Array) -> tuple[int, float]:
        """Best number of passes, and the part of a path (p, N) that is missed after them."""
        known = np.hstack([path, np.zeros((len(path), inverse.reach_samples))])
        v, errors = np.zeros_like(path), []
        with np.errstate(all="ignore"):
            for _ in range(1 + MOST_PASSES):
                v = v + inverse.run(known, np.zeros(len(inverse.A)))
                known[:, :TRIAL_SAMPLES] = error = path - self.block.respond(v)[0]
                errors.append(np.sqrt(np.mean(error[:, : TRIAL_SAMPLES // 2] ** 2) / np.mean(path**2)))
        passes = int(np.argmin(np.nan_to_num(errors, nan=np.inf)))
        return passes, float(np.nan_to_num(errors[passes], nan=np.inf))


def _half(model: HammersteinModel, limits: DriveRange) -> Array:
    """Half of the range of each input (m,) [V], that of the records where it is without end."""
    half = 0.5 * limits.span_v
    return np.asarray(np.where(np.isfinite(half), half, model.amplitude_v))
