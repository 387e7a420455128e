"""Inverse of the whole model: of its linear block with preview, then of its hysteresis."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.blocks import Law, Memory, checked_reference
from hammerstein.blocks.driving import RangeLike
from hammerstein.compensators.base import Compensator
from hammerstein.compensators.exact.inverse import ExactInverseLaw, ExactState, Recovery
from hammerstein.compensators.preview.linear_inverse import filtered_by, linear_inverse
from hammerstein.compensators.preview.loop_inverse import LoopInverseLaw, WholeInverse
from hammerstein.dynamics import LinearBlock, WithLoop
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import Frequency, Volts, Wait, interval, number_of

EFFORT = 1e-4  # small: the drive then leaves its range only when the path is nearly met again
DOUBLINGS = 11  # of one sample: a horizon of 2048
START_SAMPLES = 64  # of a path by which its beginning is judged
SEEN = 1e-9  # of a mode's sixth differences: less is rounding, and the mode starts from rest


@dataclass(frozen=True, eq=False)
class PathState(Memory):
    """Memory of the law on a stream: the references still needed, the forward modes, the exact inverse.

    raw, filtered : (p, samples) references before and after the filter; modes : (n_s,)
    away : (n,) distance of the linear block from its path; exact : memory of the static inverse
    """

    raw: Array
    filtered: Array
    modes: Array
    away: Array
    exact: ExactState


class HammersteinInverseLaw(WholeInverse[PathState]):
    """U = Gamma^-1 (G^-1 (F Y_r)): reference filter, inverse of the linear block, exact static inverse.

    ``G^-1`` is exact on the sample grid, the hold included (``linear_inverse``), so that on every sample the
    model is on the filtered reference. It needs the reference some samples ahead: one for a resonant
    axis, more for zeros outside the unit circle, half the length of the filter, and the input delay.
    On a stream the drive leaves later by ``preview_samples``; ``drive_for`` aligns a path known ahead. A
    stream starts from rest, or on a path whose first ``start_samples`` are known (``primed``).
    With less preview than that (``preview_s``), the rest is a delay of the position, ``delay_samples``.

    The filter F is a linear-phase low-pass: 1 within 0.1 % up to 0.7 ``filter_hz``, 1/2 at ``filter_hz``,
    below 0.1 % from 1.3 ``filter_hz`` on. A path with corners or jumps needs one: far above the resonance,
    the inverse requests more than any drive can supply (``linear.large_gain_hz``).

    A path known ahead may start away from rest. Before its first and after its last sample it is continued by
    its point reflection; the modes of G^-1 start so that the drive does not ring (creep starts from rest).
    The actuator starts at ``range.start_v``. A linear-quadratic feedback on the model's state inside the law
    (1 um of error weighs as much as 100 um of drive) moves it to the path from there, and back to the path
    after saturation, mostly at the range: a few milliseconds for a resonant axis.

    Parameters
    ----------
    model : m inputs, p <= m outputs
    range_v : range of the drive [V], see ``DriveRange.of``
    sample_time_s : time between samples [s]
    preview_s : how far ahead the reference is known [s]; None: as far as needed; 0: not at all
    filter_hz : bandwidth of the reference filter [Hz]; None: no filter
    softening_v, run_anyway : as for ``ExactInverseLaw``

    Attributes
    ----------
    linear : the inverse of the linear block, with its preview and gains
    preview_samples, delay_samples, delay_s, start_samples : see above

    Raises
    ------
    InputError : a filter or preview that does not fit the sample time, and what ``ExactInverseLaw`` raises
    SimulationError : no inverse of the hysteresis or of the linear block

    Examples
    --------
    >>> from hammerstein.dynamics.models import (AxesDynamics, Axis)
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> plant = PrandtlIshlinskii([[Pair([0.0, 1.0], [4.0, 2.0])]])
    >>> axis = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),))
    >>> model = HammersteinModel("one axis", plant, axis, 10.0, ("u",), ("y",))
    >>> law = HammersteinInverseLaw(model, 10.0, 50e-6)
    >>> reference_um = 20.0 * np.sin(2.0 * np.pi * 100.0 * 50e-6 * np.arange(400)) ** 3
    >>> v_um, _ = plant.respond(law.drive_for(reference_um))
    >>> y_um, _ = law.linear.block.respond(v_um)
    >>> bool(np.abs(y_um - reference_um).max() < 2e-3)
    True
    """

    def _prepare(self, model: HammersteinModel, preview_s: float | None) -> None:
        """See ``WholeInverse._prepare``."""
        sample_time_s = self.sample_time_s
        self.linear = linear_inverse(model.dynamics, sample_time_s)
        self.needed_samples = self.linear.preview_samples + len(self.taps) // 2
        self.preview_samples = self.needed_samples
        if preview_s is not None:
            if not preview_s >= 0.0:
                raise InputError("preview_s", f"must be 0 or more, not {preview_s:g}")
            self.preview_samples = min(self.needed_samples, math.floor(preview_s / sample_time_s + 1e-6))
        self.recovery = _recovery(self.linear.block)

    @property
    def delay_samples(self) -> int:
        """Delay of the position in samples, caused by limited preview."""
        return self.needed_samples - self.preview_samples

    @property
    def delay_s(self) -> float:
        """Delay of the position [s]."""
        return self.delay_samples * self.sample_time_s

    @property
    def start_samples(self) -> int:
        """Samples of a path, starting away from rest, that must be known before its first drive."""
        return self.needed_samples + START_SAMPLES

    def statement(self) -> str:
        """Properties of the law before a run: inverse of the hysteresis, preview, delay, large gains."""
        parts = [self.exact.invertibility.statement(), self.linear.statement()]
        ahead = self.preview_samples
        if ahead != self.linear.preview_samples or self.delay_samples:
            parts.append(
                f"With its filter, the law needs the reference {number_of(ahead, 'sample')} ahead "
                f"({interval(ahead * self.sample_time_s)})"
                + (f"; the position is {interval(self.delay_s)} late." if self.delay_samples else ".")
            )
        if not self.delay_samples:
            parts.append(
                f"To start a path away from rest, the law must know its first {self.start_samples} samples "
                f"({interval(self.start_samples * self.sample_time_s)})."
            )
        return " ".join(parts)

    def rest(self) -> PathState:
        """Actuator at rest, reference at zero until now."""
        p, linear = self.n_outputs, self.linear
        return PathState(
            np.zeros((p, len(self.taps) - 1)),
            np.zeros((p, linear.reach_samples)),
            np.zeros(len(linear.A)),
            np.zeros(len(linear.block.A)),
            self.exact.rest(),
        )

    def _respond(self, reference_um: Array, start: PathState) -> tuple[Array, PathState]:
        raw = np.hstack([start.raw, reference_um])
        known = np.hstack([start.filtered, filtered_by(self.taps, raw)])
        modes = start.modes.copy()
        v = self._from_rest(self.linear.run(known, modes))
        drive, exact, away = self.exact.solve(v, start.exact, start.away, self.recovery)
        samples = reference_um.shape[1]
        return drive, PathState(raw[:, samples:].copy(), known[:, samples:].copy(), modes, away, exact)

    @cached_property
    def _compiled_step(self) -> Any:
        """What is compiled, and what of the design it wants; None for another static inverse."""
        if not isinstance(self.exact, ExactInverseLaw):
            return None
        from hammerstein.compensators.preview.preview_kernel import step_path

        inverse = self.linear
        linear = (inverse.A, inverse.B, inverse.C, inverse.taps, inverse.ahead)
        return step_path, (self._frame, self.taps, linear, tuple(self.recovery), *self.exact.design_tables())

    def _step(self, sample_um: Array, state: PathState) -> tuple[Array, PathState] | None:
        if self._compiled_step is None:
            return None
        step, design = self._compiled_step
        exact = state.exact
        memory = (state.raw, state.filtered, state.modes, state.away, exact.stack, exact.hand)
        drive, raw, known, modes, away, stack, hand, sound = step(sample_um, *design, *memory)
        return (drive, PathState(raw, known, modes, away, ExactState(stack, hand))) if sound else None

    def primed(self, reference_um: ArrayLike) -> tuple[PathState, Array]:
        """State of the law at the drive of the first sample of a path (p, N) known in advance.

        The path is continued at both ends by its point reflection; the actuator is at rest at its start.
        Of a path that is not known to its end, the first ``start_samples`` suffice for the state.

        Returns
        -------
        state : the law has received the first ``preview_samples`` of the path
        coming : (p, N) the path from there on

        Raises InputError where the preview is longer than the path.
        """
        if self.delay_samples:
            return super().primed(reference_um)
        reference = checked_reference(reference_um, self.n_outputs)
        samples, needed = reference.shape[1], self.needed_samples
        if samples <= needed:
            raise InputError(
                "reference",
                f"has {samples} samples, but the law looks {needed} samples ahead; give a longer "
                "reference or a filter with more bandwidth (filter_hz)",
            )
        longest = len(self.taps) - 1
        ends = np.pad(reference, ((0, 0), (longest // 2, needed)), mode="reflect", reflect_type="odd")
        reach, seen = self.linear.reach_samples, longest // 2 + needed
        known = filtered_by(self.taps, ends[:, self.linear.delay_samples : seen + START_SAMPLES])
        modes = self._smooth_start(known)
        away = -self._block_state(known, modes)
        raw = ends[:, seen - longest : seen].copy()
        return PathState(raw, known[:, :reach].copy(), modes, away, self.exact.rest()), ends[:, seen:]

    def _smooth_start(self, known: Array) -> Array:
        """Forward modes (n_s,) with which v starts with the least sixth differences: without ringing.

        Modes so slow that the differences do not see them, creep, start from rest.
        """
        inverse = self.linear
        samples = min(START_SAMPLES, known.shape[1] - inverse.reach_samples)
        n = len(inverse.A)
        if n == 0 or samples <= 6:
            return np.zeros(n)
        forced = self.linear.run(known[:, : samples + inverse.reach_samples], np.zeros(n))
        free = np.empty((self.n_outputs, samples, n))
        power = np.eye(n)
        for k in range(samples):
            free[:, k] = inverse.C @ power
            power = inverse.A @ power
        rough, rough_free = (np.diff(v, 6, axis=1).reshape(-1, *v.shape[2:]) for v in (forced, free))
        left, sizes, right = np.linalg.svd(rough_free, full_matrices=False)
        # Against what the same modes would show if they changed sign with every sample.
        seen = sizes > SEEN * 2.0**6 * np.linalg.norm(free.reshape(-1, n), ord=2)
        return np.asarray(right[seen].T @ (left[:, seen].T @ -rough / sizes[seen]))

    def _block_state(self, known: Array, modes: Array) -> Array:
        """State (n,) of the linear block on the path at the first sample."""
        inverse = self.linear
        length = len(inverse.taps)
        ahead = np.stack([known[i, a : a + length] for i, a in enumerate(inverse.ahead)])
        return np.asarray(inverse.lift @ modes + np.einsum("jnp,pj->n", inverse.future, ahead))


def _recovery(block: LinearBlock) -> Recovery:
    """Linear-quadratic gain that brings the block back to its path; its horizon is too short for creep.

    Each round doubles the horizon of the Riccati recursion: Anderson, International Journal of Control 28
    (1978) 295-306.
    """
    a, b = block.A, block.B
    effort, one = EFFORT * np.eye(b.shape[1]), np.eye(len(a))
    value, reach, power = block.C.T @ block.C, b @ b.T / EFFORT, a
    for _ in range(DOUBLINGS):
        both = np.linalg.inv(one + reach @ value)
        later = power @ both
        value, reach = value + power.T @ value @ both @ power, reach + later @ reach @ power.T
        power = later @ power
    gain = np.linalg.solve(effort + b.T @ value @ b, b.T @ value @ a)
    return Recovery(*(np.array(matrix, order="C") for matrix in (a, b, gain)))


class HammersteinInverse(Compensator):
    """Inverse of the dynamics with preview, then exact inverse of the hysteresis.

    Dynamics with hysteresis in their loop are inverted iteratively, see ``LoopInverseLaw``.
    """

    law: Literal["hammerstein_inverse"] = "hammerstein_inverse"
    preview_s: Wait | None = Field(
        default=None, description="how far ahead the reference is known; as far as needed if omitted"
    )
    filter_hz: Frequency | None = Field(
        default=None, description="bandwidth of a reference filter, for references that are not smooth"
    )
    softening_v: Volts = Field(
        default=0.0, description="voltage over which the drive jump at a reversal is spread"
    )
    run_anyway: bool = Field(default=False, description="accept a model without an inverse")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Build the law, see ``Compensator.design``."""
        options = (self.preview_s, self.filter_hz, self.softening_v, self.run_anyway)
        if isinstance(model.dynamics, WithLoop):
            return LoopInverseLaw(model, range_v, sample_time_s, *options)
        return HammersteinInverseLaw(model, range_v, sample_time_s, *options)
