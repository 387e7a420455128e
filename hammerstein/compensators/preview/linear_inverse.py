"""Low-pass filter of a reference, and inverse of a linear block with preview."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hammerstein.arrays import Array, Complex, Indices, filled, transfer
from hammerstein.dynamics import Dynamics, LinearBlock, discretise, split_delay
from hammerstein.errors import InputError, SimulationError
from hammerstein.quantities import interval, number_of
from hammerstein.records.checks import runs

LONGEST_FILTER = 100_000
"""Most taps of a filter: two seconds of a path at 50 kHz."""


def low_pass_taps(filter_hz: float | None, sample_time_s: float) -> Array:
    """Linear-phase low-pass of odd length, 60 dB or more, from 0.7 to 1.3 of its bandwidth; one tap: none."""
    if filter_hz is None:
        return np.ones(1)
    from scipy.signal import firwin, kaiserord

    nyquist = 0.5 / sample_time_s
    if not 0.0 < filter_hz < nyquist / 1.3:
        raise InputError(
            "filter_hz", f"must be between 0 and {nyquist / 1.3:g} Hz at this sample time, not {filter_hz:g}"
        )
    length, beta = kaiserord(66.0, 0.6 * filter_hz / nyquist)
    if length > LONGEST_FILTER:
        least = filter_hz * length / LONGEST_FILTER
        raise InputError(
            "filter_hz",
            f"{filter_hz:g} Hz needs a filter of {length:.3g} samples of {interval(sample_time_s)}, but at "
            f"most {LONGEST_FILTER} are allowed; use {least:.3g} Hz or more, or a longer sample time",
        )
    return np.asarray(firwin(length | 1, filter_hz / nyquist, window=("kaiser", beta)), dtype=np.float64)


def filtered_by(taps: Array, raw: Array) -> Array:
    """Filtered reference (p, N), shorter by the length of the filter minus one."""
    from hammerstein.compensators.preview.preview_kernel import filtered

    if len(taps) == 1:
        return raw
    raw = np.ascontiguousarray(raw)
    shape = (raw.shape[0], raw.shape[1] - len(taps) + 1)
    return filled(filtered, taps, raw, shape=shape, products=taps.size * len(raw))


TAIL = 1e-8
"""Response of the inverse, relative to its largest, at which it is truncated."""
LONGEST_PREVIEW = 20_000
"""Longest response [samples]; beyond, the inverse is ill-conditioned."""
LARGE_GAIN = 10.0
"""Ratio to the drive of a slow path from which statements name a frequency band."""
NEGLIGIBLE = 1e-10
"""Entry, relative to the largest, that is rounding; its inverse is the largest condition number."""


@dataclass(frozen=True, eq=False)
class LinearInverse:
    """Input v of a block that makes its output equal to y on every sample of the grid.

        x[k+1] = A_s x[k] + B_s y+[k]
        v[k]   = C_s x[k] + sum over j of F_j y+[k+j],      y+_i[k] = y_i[k + ahead_i]

    The block gives row i of its output ``ahead_i`` samples after its input: one for a resonant axis, whose
    input is held. The zeros of the block are the modes of its inverse. Those inside the unit circle run
    forward from the past (creep, and the sampling zero near -1 of a second-order axis); those outside run
    backward from the future: they give the taps F_j, truncated where they have decayed.

    A, B, C : forward modes; taps : (j, p, p); ahead : (p,)
    lift : (n, n_s) block state of the forward modes; future : (j, n, p) block state of the backward modes
    zeros : finite zeros of the block
    delay_samples : whole samples of the input delay, which only add to the preview
    """

    block: LinearBlock
    A: Array
    B: Array
    C: Array
    taps: Array
    ahead: Indices
    lift: Array
    future: Array
    zeros: Complex
    delay_samples: int

    @property
    def preview_samples(self) -> int:
        """Samples of the reference that must be known before the drive."""
        return self.delay_samples + self.reach_samples

    @property
    def reach_samples(self) -> int:
        """The same for the block without its input delay."""
        return int(self.ahead.max()) + len(self.taps) - 1

    def run(self, known: Array, modes: Array) -> Array:
        """Inputs v (p, N) for outputs known (p, N + reach_samples); ``modes`` (n_s,) move on."""
        from hammerstein.compensators.preview.preview_kernel import run_inverse

        known = np.ascontiguousarray(known)
        given = (self.A, self.B, self.C, self.taps, self.ahead, modes, known)
        shape = (len(known), known.shape[1] - self.reach_samples)
        return filled(run_inverse, *given, shape=shape, products=self.A.size + self.taps.size)

    def response(self, frequency_hz: Array) -> Complex:
        """Frequency response (frequency, p, p) from y to v, without preview and input delay."""
        z = np.exp(2j * np.pi * frequency_hz * self.block.sample_time_s)
        direct = np.einsum("jvy,fj->fvy", self.taps, z[:, None] ** np.arange(len(self.taps)))
        return transfer(self.A, self.B, self.C, direct, z) * z[:, None, None] ** self.ahead

    @cached_property
    def large_gain_hz(self) -> tuple[tuple[float, float], ...]:
        """Bands [Hz] in which the gain from y to v exceeds ten times the static one."""
        grid = np.linspace(0.0, 0.5 / self.block.sample_time_s, 4001)[1:-1]
        gain = np.linalg.norm(np.linalg.inv(self.block.response(grid)), ord=2, axis=(1, 2))
        still = np.linalg.norm(np.linalg.inv(self.block.response(0.0))[0], ord=2)
        return tuple((float(grid[a]), float(grid[b])) for a, b in runs(gain > LARGE_GAIN * still))

    def statement(self) -> str:
        """State the preview, and the frequencies with large gain."""
        ahead = self.preview_samples
        samples, time = number_of(ahead, "sample"), interval(ahead * self.block.sample_time_s)
        text = f"The inverse of the dynamics looks {samples} ahead ({time})"
        zeros = sorted(np.abs(self.zeros)[np.abs(self.zeros) > 1.0])
        if zeros:
            text += f", for {len(zeros)} zeros outside the unit circle (the slowest at |z| = {zeros[0]:.4g})"
        bands = ", ".join(f"{low:.4g} to {high:.4g}" for low, high in self.large_gain_hz)
        if bands:
            text += f"; at {bands} Hz it needs over {LARGE_GAIN:g} times the voltage of a slow path"
        return text + "."


def linear_inverse(dynamics: Dynamics, sample_time_s: float) -> LinearInverse:
    """Invert a linear block on a sample grid, exactly for an input held over each sample.

    Row i of the output first responds to the input after d_i samples, by the row ``C_i A^(d_i - 1) B`` (or
    D_i if d_i = 0). Where these rows form a regular matrix E,

        v[k] = E^-1 (y+[k] - L x[k]),    x[k+1] = (A - B E^-1 L) x[k] + B E^-1 y+[k],    L_i = C_i A^d_i

    is the inverse. Its modes are split by an ordered real Schur form and a Sylvester equation.

    Raises
    ------
    InputError : a delay or a discrete block that does not fit the sample time
    SimulationError : an unstable block, a singular E, a zero on the unit circle or so near to it that the
        preview would be too long

    Source: Devasia, Chen and Paden, IEEE Transactions on Automatic Control 41 (1996) 930-942 (stable
    inversion); Zou and Devasia, Journal of Dynamic Systems, Measurement, and Control
    121 (1999) 625-630 (preview).

    Examples
    --------
    >>> from hammerstein.dynamics import AxesDynamics, Axis
    >>> axis = AxesDynamics(axes=(Axis(resonance_hz=280.0, damping_ratio=0.12),))
    >>> linear_inverse(axis, 50e-6).preview_samples
    1
    """
    discretise(dynamics, sample_time_s)  # the delay may be too long
    delay, late_s = split_delay(dynamics.input_delay_s, sample_time_s)
    plain = discretise(dynamics.model_copy(update={"input_delay_s": late_s}), sample_time_s)
    return block_inverse(plain, delay)


def block_inverse(plain: LinearBlock, delay: int = 0) -> LinearInverse:
    """Invert a block on its grid, with an input delay of ``delay`` samples.

    Raises SimulationError as ``linear_inverse`` does.
    """
    _require_stable(plain)
    ahead, first, free = _first_reaction(plain)
    gain = np.linalg.inv(first)
    a, b = plain.A - plain.B @ gain @ free, plain.B @ gain
    inner, outer, lift, lift_outer, zeros = _split(a, b)
    c = -gain @ free
    future = _backward(*outer, lift_outer, c, plain)
    taps = np.einsum("vn,jny->jvy", c, future)
    taps[0] += gain
    # Copies in the order of rows: the compiled loop is then compiled once.
    rows = (np.array(matrix, order="C") for matrix in (*inner, c @ lift, taps))
    forward_a, forward_b, forward_c, near = rows
    inverse = LinearInverse(plain, forward_a, forward_b, forward_c, near, ahead, lift, future, zeros, delay)
    _require_accurate(inverse)
    return inverse


def _require_stable(block: LinearBlock) -> None:
    poles = np.abs(np.linalg.eigvals(block.A)) if len(block.A) else np.zeros(1)
    if poles.max() >= 1.0:
        raise SimulationError(
            f"The linear block is not stable (a pole at |z| = {poles.max():.6g}), so no drive "
            "computed in advance can control it. Close a loop around it first, or identify it again."
        )


def _first_reaction(block: LinearBlock) -> tuple[Indices, Array, Array]:
    """Samples after which each output first responds to the input, how, and what it does without input."""
    p, n = block.n_outputs, len(block.A)
    ahead, first = np.zeros(p, np.int64), block.D.copy()
    free = block.C.copy()
    reactions = [block.D]
    row = block.C
    for _ in range(n):
        reactions.append(row @ block.B)
        row = row @ block.A
    sizes = np.abs(np.array(reactions)).max(axis=2)
    for i in range(p):
        moving = np.flatnonzero(sizes[:, i] > NEGLIGIBLE * max(float(sizes[:, i].max()), 1e-300))
        if len(moving) == 0:
            raise SimulationError(
                f"Output {i + 1} of the linear block responds to no input, so there is no inverse."
            )
        ahead[i] = moving[0]
        first[i] = reactions[moving[0]][i]
        free[i] = block.C[i] @ np.linalg.matrix_power(block.A, int(moving[0]))
    scaled = first / np.abs(first).max(axis=1, keepdims=True)
    if np.linalg.cond(scaled) > 1.0 / NEGLIGIBLE:
        delays = ", ".join(str(d) for d in ahead)
        raise SimulationError(
            f"After {delays} samples, the outputs of the linear block first respond to the same "
            "combination of inputs, so there is no inverse by simple advances. Identify one delay "
            "for all axes (input_delay_s), or reduce the model's order."
        )
    return ahead, first, free


def _split(a: Array, b: Array) -> tuple[tuple[Array, Array], tuple[Array, Array], Array, Array, Complex]:
    """Modes of x[k+1] = a x[k] + b y inside and outside the unit circle, and how to come back to x."""
    from scipy.linalg import schur, solve_sylvester

    n = len(a)
    if n == 0:
        return (a, b), (a, b), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0, complex)
    t, q, inside = schur(a, output="real", sort=lambda re, im: math.hypot(re, im) < 1.0)
    shear = solve_sylvester(t[:inside, :inside], -t[inside:, inside:], -t[:inside, inside:])
    basis = q @ np.block([[np.eye(inside), shear], [np.zeros((n - inside, inside)), np.eye(n - inside)]])
    modal = np.linalg.solve(basis, b)
    forward = (t[:inside, :inside], modal[:inside])
    backward = (t[inside:, inside:], modal[inside:])
    return forward, backward, basis[:, :inside], basis[:, inside:], np.linalg.eigvals(a).astype(complex)


def _backward(a: Array, b: Array, lift: Array, c: Array, block: LinearBlock) -> Array:
    """Block state (j, n, p) that the backward modes take from each sample of the future, cut at its tail.

    c : (p, n) what v takes from the block state; the tail that is cut adds less than TAIL um per um to v.
    """
    n, p = len(block.A), block.n_outputs
    if len(a) == 0:
        return np.zeros((1, n, p))
    radius = float(np.abs(np.linalg.eigvals(a)).min())
    rows: list[Array] = []
    inverse = np.linalg.inv(a)
    power = inverse @ b
    # The rows die out like a geometric series of the slowest mode, whose sum this keeps below the tail.
    enough = TAIL * (radius - 1.0) / radius
    while len(rows) <= LONGEST_PREVIEW:
        rows.append(-lift @ power)
        if max(float(np.abs(rows[-1]).max()), float(np.abs(c @ rows[-1]).max())) < enough:
            return np.array(rows)
        power = inverse @ power
    raise SimulationError(
        f"The linear block has a zero at |z| = {radius:.9g}, on the unit circle or just outside. Its "
        f"inverse would need more than {interval(LONGEST_PREVIEW * block.sample_time_s)} of preview. "
        "Reduce the order of the model, or compensate without its dynamics."
    )


def _require_accurate(inverse: LinearInverse) -> None:
    """Check that block and inverse cancel, which poor conditioning could prevent."""
    frequency = np.linspace(0.0, 0.4, 9)[1:] / inverse.block.sample_time_s
    both = inverse.block.response(frequency) @ inverse.response(frequency)
    error = float(np.abs(both - np.eye(inverse.block.n_outputs)).max())
    if not error < 1e-5:
        raise SimulationError(
            f"Rounding errors spoil the inverse of the linear block (error {error:.2g}): the model's "
            "matrices are badly scaled or its order is too high. Reduce the order."
        )
