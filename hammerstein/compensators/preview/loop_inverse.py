"""Inverse of dynamics with hysteresis in their loop by repeated linearisation, with preview."""

import contextlib
import itertools
from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from hammerstein.arrays import Array, times
from hammerstein.blocks import Law, Memory, checked_reference
from hammerstein.blocks.driving import RangeLike
from hammerstein.blocks.law import S
from hammerstein.compensators.exact.inverse import exact_inverse_of
from hammerstein.compensators.preview.linear_inverse import (
    LinearInverse,
    block_inverse,
    filtered_by,
    low_pass_taps,
)
from hammerstein.dynamics import FeedbackBlock, LinearBlock, on_grid, split_delay
from hammerstein.dynamics.feedback_hysteresis import FAR_V
from hammerstein.errors import InputError, SimulationError
from hammerstein.model import HammersteinModel
from hammerstein.quantities import interval
from hammerstein.signals import smooth_step

MOST_PASSES, PATIENCE = 24, 3
"""Largest number of passes, and how many in a row may be worse than the best."""
MOST_STEPS, REMEMBERED = 60, 3
"""Accelerated steps of each gain on a path known as a whole, and the remembered ones. On waves up
to twice the resonance of two made-up stacks, 40 steps left 0.0001 to 0.003 of the path with every gain but
the smallest; where 12 or 25 were remembered, up to 0.8."""
ENOUGH = 1e-4
"""Allowed error, in parts of the path: identified models have twenty times as much and more."""
BEGINNINGS = (1, 4, 16)
"""Duration of the soft start of a path that begins away from rest, in parts of the inverse's reach."""
SHARES = (0.25, 0.5, 0.1, 1.0)
"""Parts of the range, for the slow loops whose gains are tried."""
TRIAL_SAMPLES = 2000  # of the path on which the passes are tried
TRIAL_PART = 0.3
"""Amplitude of the trial path, in parts of the slow reach."""
TRIAL_BAND, TRIAL_WAVES = 0.6, 8
"""Highest frequency of the trial path over the lowest resonance, and its lines: on a slow path, a gain with
which the passes diverge near the resonance can be the best."""


@dataclass(frozen=True, eq=False)
class PassState(Memory):
    """Memory of one pass.

    missed : (p, reach) references still to be inverted; pushed : (q, reach) their disturbances
    modes : (n_s,) of the inverse; moved, inner : (n,) states of the linear block; hysteresis : of Gamma
    """

    missed: Array
    pushed: Array
    modes: Array
    moved: Array
    inner: Array
    hysteresis: Any


@dataclass(frozen=True, eq=False)
class LoopPass:
    """Inverse of a loop whose hysteresis is a gain K plus a known disturbance.

        x+ = (A + E K F) x + (B + E K G) v + E d,    y = C x + D v = r,    z = F x + G v

    On the path, r determines the states, so that d, which is w - K z of the previous pass, changes z little
    even near a resonance. If Gamma moves twice in a sample, z and d are those of both moves.
    """

    block: FeedbackBlock
    gain: Array

    @cached_property
    def inverse(self) -> LinearInverse:
        """Inverse of the linear block; raises SimulationError where it has none."""
        return block_inverse(self.block.with_gain(self.gain))

    @cached_property
    def _moved(self) -> LinearBlock:
        """What d alone does to y."""
        both, m, c = self.block.beside(self.gain), self.block.n_inputs, self.block.C
        return LinearBlock(both.A, both.B[:, m:], c, both.D[: len(c), m:], both.sample_time_s)

    @cached_property
    def _inner(self) -> LinearBlock:
        """From v and d to z."""
        both, p = self.block.beside(self.gain), self.block.n_outputs
        return LinearBlock(both.A, both.B, both.C[p:], both.D[p:], both.sample_time_s)

    def rest(self) -> PassState:
        """Loop at rest, reference and disturbance at zero until now."""
        reach, n, q = self.inverse.reach_samples, len(self.block.A), self.block.E.shape[1]
        return PassState(
            np.zeros((self.block.n_outputs, reach)),
            np.zeros((q, reach)),
            np.zeros(len(self.inverse.A)),
            np.zeros(n),
            np.zeros(n),
            self.block.hysteresis.rest(),
        )

    def run(self, path: Array, pushed: Array, state: PassState) -> tuple[Array, Array, PassState]:
        """Inputs v (p, N) and next d (q, N), ``reach_samples`` before the path (p, N) and d (q, N) given."""
        samples = path.shape[1]
        moved, moved_on = self._moved.respond(pushed, state.moved)
        missed, waiting = np.hstack([state.missed, path - moved]), np.hstack([state.pushed, pushed])
        modes = state.modes.copy()
        v = self.inverse.run(missed, modes)
        z, inner = self._inner.respond(np.vstack([v, waiting[:, :samples]]), state.inner)
        moves = self.block.moves  # one after the other
        z = z.reshape(moves, -1, samples).transpose(1, 2, 0).reshape(-1, samples * moves)
        w, hysteresis = self.block.hysteresis.respond(z, state.hysteresis)
        d = w + self.block.products.at(z) - times(self.gain, z)
        d = d.reshape(-1, samples, moves).transpose(2, 0, 1).reshape(-1, samples)
        late = missed[:, samples:].copy(), waiting[:, samples:].copy()
        return v, d, PassState(*late, modes, moved_on, inner, hysteresis)

    def tried(self, path: Array) -> tuple[int, float]:
        """Number of passes after the first, and their error relative to a path (p, N) from rest."""
        reach, errors = self.inverse.reach_samples, []
        known = np.hstack([path, np.zeros((len(path), reach))])
        pushed = np.zeros((self.block.E.shape[1], known.shape[1]))
        with np.errstate(all="ignore"):
            for _ in range(1 + MOST_PASSES):
                v, d, _ = self.run(known, pushed, self.rest())
                pushed = np.hstack([d[:, reach:], np.repeat(d[:, -1:], reach, axis=1)])
                error = path - self.block.respond(v[:, reach:])[0]
                errors.append(float(np.nan_to_num(np.sqrt(np.mean(error**2) / np.mean(path**2)), nan=np.inf)))
                if errors[-1] < ENOUGH or len(errors) - 1 - np.argmin(errors) >= PATIENCE:
                    break
        return int(np.argmin(errors)), min(errors)

    def solved(self, known: Array) -> tuple[float, Array]:
        """Relative error on a path from rest, and the inputs v (m, N), by Anderson acceleration.

        It solves for the fixed point of d and converges where plain passes diverge.

        known : (p, N + reach_samples) path and its continuation

        Source: D. G. Anderson, Journal of the ACM 12 (1965) 547-560.
        """
        from scipy.optimize import NoConvergence, anderson  # it takes long to load

        reach = self.inverse.reach_samples
        path, begun = known[:, :-reach], np.zeros((self.block.E.shape[1], known.shape[1]))
        best, v_best = np.inf, np.zeros((self.block.n_inputs, path.shape[1]))

        def missed(pushed: Array) -> Array:
            nonlocal best, v_best
            v, d, _ = self.run(known, pushed, self.rest())
            error = path - self.block.respond(v[:, reach:])[0]
            left = float(np.sqrt(np.sum(error**2) / np.sum(path**2)))
            if left < best:
                best, v_best = left, v[:, reach:]
            if not ENOUGH < left < np.inf:
                raise StopIteration
            return np.hstack([d[:, reach:], np.repeat(d[:, -1:], reach, axis=1)]) - pushed

        with np.errstate(all="ignore"), contextlib.suppress(StopIteration, NoConvergence):
            search = cast(Any, anderson)  # its stubs take functions that give a number
            search(missed, begun, alpha=1.0, M=REMEMBERED, maxiter=MOST_STEPS, line_search=None)
        return best, v_best


@dataclass(frozen=True, eq=False)
class LoopPathState(Memory):
    """Memory of the law on a stream.

    raw : (p, samples) references before the filter; path : (p, samples) behind it
    passes : memory of each pass; exact : of the static inverse
    """

    raw: Array
    path: Array
    passes: tuple[PassState, ...]
    exact: Any


class WholeInverse(Law[S]):
    """Inverse of a whole model on a sample grid, the base of two laws: what both are made of."""

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
        self.taps = low_pass_taps(filter_hz, sample_time_s)
        self._prepare(here, preview_s)

    @abstractmethod
    def _prepare(self, model: HammersteinModel, preview_s: float | None) -> None:
        """Invert the dynamics of the model on its grid, and set the preview."""


class LoopInverseLaw(WholeInverse[LoopPathState]):
    """Inverse of a model with hysteresis in the loop of its dynamics, for a path known in advance.

        d_0 = 0,    v_i = the inverse of the loop with Gamma = K z + d_i,    d_(i+1) = Gamma(z_i) - K z_i

    and U = Gamma_0^-1 v: every pass inverts a linear block exactly on the sample grid (``LoopPass``,
    ``linear_inverse``). K are the gains of slow loops over a part of the range (``FeedbackBlock.slow_gain``)
    or of the largest amplitudes, whichever has the smaller error on a trial path. Gamma_0 is a hysteresis in
    front of the dynamics. Each pass needs ``reach_samples`` more preview. A path that is known as a whole
    (``drive_for``) uses accelerated steps of its own, which also converge where passes diverge.

    The actuator starts at rest at its working point. The law does not account for saturation of the drive.

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
    loops : the gains that have an inverse; a path known as a whole is tried with all of them
    loop, passes, left : gain and number of passes of a stream, and their error relative to the trial path

    Raises
    ------
    InputError : too little preview, a start away from the working point, and as ``HammersteinInverseLaw``
    SimulationError : no inverse of the linear block, or passes that do not come nearer to the path

    Source: fixed-point iteration on the nonlinear remainder of a linear model, with the outputs
    prescribed; Devasia, Chen and Paden, IEEE Transactions on Automatic Control 41 (1996) 930-942, section 3.
    """

    leaves: ClassVar[float] = ENOUGH

    def _prepare(self, model: HammersteinModel, preview_s: float | None) -> None:
        """See ``WholeInverse._prepare``."""
        sample_time_s = self.sample_time_s
        if self.range.history().shape[1] > 1:
            raise InputError(
                "start", "hysteresis in the loop is only inverted from rest at the working point"
            )
        delay, late_s = split_delay(model.dynamics.input_delay_s, sample_time_s)
        plain = on_grid(model.dynamics.model_copy(update={"input_delay_s": late_s}), sample_time_s)
        assert isinstance(plain, FeedbackBlock)
        self.block = plain
        self.loops, self.loop, self.passes, self.left = self._tried(model)
        self._early = len(self.taps) // 2 + delay
        self.preview_samples = (1 + self.passes) * self.loop.inverse.reach_samples + self._early
        if preview_s is not None and preview_s < self.preview_samples * sample_time_s:
            needed = interval(self.preview_samples * sample_time_s)
            raise InputError("preview_s", f"hysteresis in the loop needs {needed} here, not {preview_s:g}")

    def statement(self) -> str:
        """State properties of the law before a run: passes, preview, start."""
        ahead = self.preview_samples
        return (
            f"{self.exact.invertibility.statement()} The hysteresis in the loop is inverted in "
            f"{self.passes} iterations on a stream, with an error of {self.left:.1g} of a trial path; a path "
            "that is known as a whole is iterated further. The reference must be known "
            f"{ahead} samples ahead ({interval(ahead * self.sample_time_s)}); a path that is no period must "
            "start at rest (--lead-in), and one that starts with a velocity may be missed (smooth_start_s)."
        )

    def rest(self) -> LoopPathState:
        """Actuator at rest, reference at zero until now."""
        p, reach = self.n_outputs, self.loop.inverse.reach_samples
        return LoopPathState(
            np.zeros((p, len(self.taps) - 1)),
            np.zeros((p, self.passes * reach)),
            tuple(self.loop.rest() for _ in range(1 + self.passes)),
            self.exact.rest(),
        )

    def _respond(self, reference_um: Array, start: LoopPathState) -> tuple[Array, LoopPathState]:
        raw = np.hstack([start.raw, reference_um])
        path = np.hstack([start.path, filtered_by(self.taps, raw)])
        reach, samples = self.loop.inverse.reach_samples, reference_um.shape[1]
        pushed, after = np.zeros((self.block.E.shape[1], samples)), []
        for i, state in enumerate(start.passes):
            late = (self.passes - i) * reach  # each pass is further behind the newest reference
            v, pushed, one = self.loop.run(path[:, late : late + samples], pushed, state)
            after.append(one)
        drive, exact, _ = self.exact.solve(self._from_rest(v), start.exact, np.zeros(0))
        return drive, LoopPathState(raw[:, samples:].copy(), path[:, samples:].copy(), tuple(after), exact)

    def drive_for(self, reference_um: ArrayLike) -> Array:
        """Drive (m, N) aligned with a reference (p, N) known in advance; its last value is held.

        It iterates on this path with the gains of least error within the range: several drives can reach a
        path at the samples, and some of them oscillate between.
        """
        reference = checked_reference(reference_um, self.n_outputs)
        least, drive = (True, np.inf), np.zeros((self.n_inputs, reference.shape[1]))
        for path, one in itertools.product(self._begun(reference), self.loops):
            left, v = one.solved(self._known(one, path))
            found = self.exact.solve(self._from_rest(v), self.exact.rest(), np.zeros(0))[0]
            now = bool(self.range.reached(self.range.absolute(found)).any()), left
            if now <= least:
                least, drive = now, found
            if least <= (False, ENOUGH) or not reference.any():
                break
        return self.range.absolute(drive)

    def softens(self, reference_um: Array) -> bool:
        """Whether a path (p, N) begins away from rest."""
        return bool(np.abs(reference_um[:, 0]).max() > ENOUGH * np.abs(reference_um).max())

    def _begun(self, reference: Array) -> Iterator[Array]:
        """The path, or one that grows to it from rest, ever more slowly: a jump would end at the range.

        There the hysteresis would take another way than the law's, and all of the path would be missed.
        """
        if not self.softens(reference):
            yield reference
            return
        for share in BEGINNINGS:
            samples = max(share * self.loop.inverse.reach_samples, 1)
            yield reference * smooth_step(np.arange(reference.shape[1]) / samples)

    def _known(self, loop: LoopPass, reference: Array) -> Array:
        """Filtered path (p, N + reach_samples) on which the inputs of a loop stand."""
        before = np.zeros((len(reference), len(self.taps) - 1))
        after = np.repeat(reference[:, -1:], self._early + loop.inverse.reach_samples, axis=1)
        return filtered_by(self.taps, np.hstack([before, reference, after]))[:, self._early :]

    def _tried(self, model: HammersteinModel) -> tuple[list[LoopPass], LoopPass, int, float]:
        """Loops with an inverse; the one with the least error on a trial path, its passes, and that error.

        Raises SimulationError if no linear block has an inverse, or all passes diverge.
        """
        half = 0.5 * self.range.span_v
        half = np.where(np.isfinite(half), half, model.amplitude_v)  # of the records, where there is no end
        ends = model.hysteresis.amplitude(half).sum(axis=1)
        size = TRIAL_PART * np.abs(model.amplitude(half)).max(axis=1)
        gains = [self.block.slow_gain(share * ends) for share in SHARES]
        loops, refused = [], None
        for gain in (*gains, self.block.hysteresis.gain(FAR_V)):
            one = LoopPass(self.block, gain)
            try:
                loops.append((one, _trial_path(one.inverse, size)))
            except SimulationError as error:
                refused = error
        if not loops and refused:
            raise refused
        loops.sort(key=lambda pair: pair[0].inverse.reach_samples)  # a long one is seldom needed, and slow
        best: tuple[LoopPass, int, float] = (loops[0][0], 0, np.inf)
        for one, path in loops:
            if best[2] >= ENOUGH:
                best = min(best, (one, *one.tried(path)), key=lambda found: found[2])
        if not best[2] < 1.0:
            raise SimulationError(
                "The hysteresis in the loop is too strong for an inverse by iterations: they diverge "
                "on a trial path. Use law none, with feedback or learning around it"
            )
        return [one for one, _ in loops], *best


def _trial_path(inverse: LinearInverse, size_um: Array) -> Array:
    """Swelling and fading waves (p, N) up to a part of the lowest resonance of a linear block."""
    angles = np.abs(np.angle(np.linalg.eigvals(inverse.block.A)))
    lowest = angles[angles > 0.0].min(initial=np.pi)
    k = np.arange(1, 1 + TRIAL_WAVES)
    turns = np.outer(k / TRIAL_WAVES * TRIAL_BAND * lowest, np.arange(TRIAL_SAMPLES))
    phases = np.outer(1 + np.arange(len(size_um)), np.pi * k**2 / TRIAL_WAVES)  # Schroeder's: a low peak
    waves = np.cos(turns + phases[:, :, None]).sum(axis=1)
    swell = np.sin(np.pi * np.arange(TRIAL_SAMPLES) / TRIAL_SAMPLES) ** 4
    return np.asarray((size_um / np.abs(waves).max(axis=1))[:, None] * waves * swell)
