"""A linear block with hysteresis in its loop, on one sample grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import Field, model_validator

from hammerstein.arrays import Array, ByValue, Indices, freeze, freeze_fields, spans, times
from hammerstein.dynamics.linear_block import CONTINUOUS, LinearBlock, SteppedBlock, entries_of
from hammerstein.hysteresis import Hysteresis, PrandtlIshlinskii
from hammerstein.quantities import Entry, InputNumber
from hammerstein.validation import Strict

if TYPE_CHECKING:
    from hammerstein.blocks.block_system import Packing

MOST_FACTORS = 3
"""Highest order of a product."""


@dataclass(frozen=True, eq=False)
class InputProducts(ByValue):
    """Weighted products of up to three z, each relative to its limit and clipped to it.

        w_i = sum over j of K_ij part_a part_b part_c,    part_k = z_k / limit_k within -1 to 1

    They are bounded, so they do not change the stability at large amplitudes.

    weights : K (q, M); limit : (h,); factors : (M, 3) numbers of the z in each product, h for none
    """

    weights: Array
    limit: Array
    factors: Indices

    def __post_init__(self) -> None:
        freeze_fields(self, "weights", "limit")
        freeze(self.factors)

    @classmethod
    def none(cls, inputs: int, outputs: int) -> InputProducts:
        """No products, for given numbers of z and w."""
        return cls(np.zeros((outputs, 0)), np.ones(inputs), np.zeros((0, MOST_FACTORS), dtype=np.int64))

    def at(self, z: Array) -> Array:
        """Contribution to w (q,) or (q, sample) for z (h,) or (h, sample)."""
        part = np.clip((z.T / self.limit).T, -1.0, 1.0)
        each = np.prod(np.concatenate([part, np.ones_like(part[:1])])[self.factors], axis=1)
        return times(self.weights, each)


class ProductFile(Strict):
    """One product of inputs of the hysteresis in the loop, numbered from 1, and its weight on each output."""

    of: Annotated[tuple[InputNumber, ...], Field(min_length=1, max_length=MOST_FACTORS)]
    weights: tuple[Entry, ...]


class ProductsFile(Strict):
    """Products in parallel to the hysteresis in a loop, and their saturation limits."""

    limits: tuple[Annotated[Entry, Field(gt=0.0)], ...]
    terms: Annotated[tuple[ProductFile, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _of_inputs(self) -> Self:
        if any(not 1 <= k <= len(self.limits) for term in self.terms for k in term.of):
            raise ValueError(f"terms are products of inputs 1 to {len(self.limits)}, as many as limits")
        return self

    @classmethod
    def of(cls, products: InputProducts) -> ProductsFile | None:
        """File form of products; None if there are none."""
        if not len(products.factors):
            return None
        h = len(products.limit)
        terms = [
            ProductFile(of=tuple(k + 1 for k in row if k < h), weights=tuple(weights))
            for row, weights in zip(products.factors.tolist(), products.weights.T.tolist(), strict=True)
        ]
        return cls(limits=tuple(products.limit.tolist()), terms=tuple(terms))

    def products(self) -> InputProducts:
        """Return the products this describes."""
        h = len(self.limits)
        rows = [[k - 1 for k in term.of] + [h] * (MOST_FACTORS - len(term.of)) for term in self.terms]
        weights = np.ascontiguousarray(np.array([term.weights for term in self.terms]).T)
        return InputProducts(weights, np.array(self.limits), np.array(rows, dtype=np.int64))


TURNS_OF_SIZES = 50
"""Iterations for the amplitudes of z and their gains."""
LEAST_SIZE = 1e-9
"""Smallest size of a z, as a part of the input: its gain is that of small loops."""

SMALL = 1e-6
"""Size of loops in which only what follows at once moves, in the unit of z."""


@dataclass(frozen=True, eq=False, repr=False)
class FeedbackBlock(SteppedBlock, ByValue):
    """Hysteresis inside the loop of a linear block, on one sample grid.

        z[k] = F x[k] + G u[k],    w[k] = Gamma(z[0 ... k]) + products of z[k]
        x[k+1] = A x[k] + B u[k] + E w[k],    y[k] = C x[k] + D u[k]

    There is no algebraic loop: z does not depend on w of the same sample, so w[k] is exact and not that of
    the sample before. A block in continuous time is put on a grid by ``held``.

    With an H, Gamma moves twice in a sample: to the z after the jump of u, and to that of its end,

        z2[k] = F2 x[k] + G2 u[k] + H w[k],    x[k+1] = A x[k] + B u[k] + E w[k] + E2 w2[k],

    so that w can be linear within a sample, as in Heun's rule. F and G hold the rows of both moves, E the
    columns of both. At ten samples per period of a resonance, a held w was the largest error of stacks.

    The state (n + memory,) is x, followed by what Gamma remembers: its plays, or the numbers of any other
    kind's memory.

    A : (n, n), B : (n, m), C : (p, n), D : (p, m), E : (n, v q), F : (v h, n), G : (v h, m) for v moves
    H : (h, q), or (0, q) where Gamma moves once, as where it is not given
    products : of z, none if not given
    hysteresis : h inputs, q outputs
    sample_time_s : 0 for matrices in continuous time, to be put on a grid by ``held``
    """

    called: ClassVar[str] = "feedback block"

    A: Array
    B: Array
    C: Array
    D: Array
    E: Array
    F: Array
    G: Array
    hysteresis: Hysteresis[Any]
    sample_time_s: float
    products: InputProducts = field(default=None)  # type: ignore[assignment]  # none of them
    H: Array = field(default=None)  # type: ignore[arg-type]  # one move

    def __post_init__(self) -> None:
        if self.H is None:
            object.__setattr__(self, "H", np.zeros((0, self.hysteresis.n_outputs)))
        freeze_fields(self, *"ABCDEFGH")
        if self.products is None:
            none = InputProducts.none(self.hysteresis.n_inputs, self.hysteresis.n_outputs)
            object.__setattr__(self, "products", none)

    def __repr__(self) -> str:
        return f"FeedbackBlock(order {len(self.A)}, {self.hysteresis.describe()} in the loop)"

    def with_gain(self, gain: Array) -> LinearBlock:
        """Return the linear block with a gain (q, h) instead of Gamma."""
        both = self.beside(gain)
        return LinearBlock(both.A, both.B[:, : self.n_inputs], self.C, self.D, self.sample_time_s)

    def beside(self, gain: Array) -> LinearBlock:
        """From u and d (v q,) to y and z (v h,), where w is d and a gain (q, h) times z, at every move."""
        late = self.late
        gains = np.kron(np.eye(self.moves), gain)
        z = np.linalg.solve(np.eye(len(late)) - late @ gains, np.hstack([self.F, self.G, late]))
        n, pushed = len(self.A), self.E @ gains @ z
        a, b = self.A + pushed[:, :n], np.hstack([self.B, self.E]) + pushed[:, n:]
        d = np.vstack([np.hstack([self.D, np.zeros((len(self.D), len(late.T)))]), z[:, n:]])
        return LinearBlock(a, b, np.vstack([self.C, z[:, :n]]), d, self.sample_time_s)

    @property
    def moves(self) -> int:
        """Number of moves of Gamma per sample."""
        return 1 + bool(len(self.H))

    @property
    def late(self) -> Array:
        """What z takes of w (v h, v q): at the second move the first w."""
        (rows, q), h = self.H.shape, len(self.F) - len(self.H)
        return np.block([[np.zeros((h, self.E.shape[1]))], [self.H, np.zeros((rows, self.E.shape[1] - q))]])

    def slow_gain(self, u: Array) -> Array:
        """Gains (q, h) that Gamma has in slow settled loops from -u to u (m,)."""
        return self._slow_loop(u)[0]

    def slow_ends(self, u: Array) -> Array:
        """Outputs (p, number) at the ends of slow settled loops from -u to u, for inputs u (m, number) there.

        All z turn together; their sizes are those that the loop itself gives them.
        """
        return np.stack([0.5 * (self._slow_loop(end)[1] - self._slow_loop(-end)[1]) for end in u.T], axis=1)

    def _slow_loop(self, u: Array) -> tuple[Array, Array]:
        """Gain (q, h) of Gamma in a slow settled loop, and outputs (p,) at its end, where inputs are u."""
        held = np.eye(len(self.A)) if self.sample_time_s != CONTINUOUS else np.zeros_like(self.A)
        x, z = self.rest()[: len(self.A)], np.full(self.hysteresis.n_inputs, np.abs(u).max())
        for _ in range(TURNS_OF_SIZES):
            sizes = np.maximum(np.abs(z), LEAST_SIZE * np.abs(u).max() or SMALL)
            gain = self.hysteresis.amplitude(sizes) / sizes
            block = self.with_gain(gain)
            pushed = block.B @ u + self.E @ np.tile(self.products.at(z), self.moves)
            x = np.linalg.lstsq(held - block.A, pushed, rcond=None)[0]
            z = (self.F @ x + self.G @ u)[: len(z)]
        return gain, np.asarray(self.C @ x + self.D @ u)

    def held(self, sample_time_s: float, late_s: float = 0.0) -> FeedbackBlock:
        """Put a block in continuous time on a grid, for u held over each sample.

        The input may come ``late_s`` late, less than a sample; see ``LinearBlock.held``.

        The slope that Gamma has in small loops is part of the linear block, which is exact. What is left of w
        is linear within a sample, from the z at its beginning to the one that this w leads to: the error
        falls with the square of the sample time (Heun). With a rate in Gamma, which would take the second
        move for one of a whole sample, that w is held.
        """
        slope, own = self.hysteresis.gain(SMALL), self.hysteresis.on_grid(sample_time_s)
        a, b = self.A + self.E @ slope @ self.F, self.B + self.E @ slope @ self.G
        linear = LinearBlock(a, b, *self._seen, CONTINUOUS).held(sample_time_s, late_s)
        late = len(linear.A) - len(a)  # the last input is a state until the new one arrives
        steady, rising = _held_and_rising(a, self.E, sample_time_s)
        e, rise = (np.pad(one, ((late, 0), (0, 0))) for one in (steady, rising))
        here = replace(self, hysteresis=own, sample_time_s=sample_time_s)._around(linear, e)
        if self.hysteresis.on_grid(2.0 * sample_time_s) == own:
            f = np.vstack([here.F, self.F @ linear.A[late:]])
            g = np.vstack([here.G, self.F @ linear.B[late:] + self.G])
            here = replace(here, E=np.hstack([e - rise, rise]), F=f, G=g, H=self.F @ steady)
        return here._less(slope)

    def _less(self, slope: Array) -> FeedbackBlock:
        """The same block where w is that of Gamma, and was what is left of it beside a slope (q, h)."""
        (h, q), m, p = slope.T.shape, self.n_inputs, self.n_outputs
        both = self.beside(-slope)
        b, e = both.B[:, :m], both.B[:, m:]
        g, late = both.D[p:, :m], both.D[p + h :, m : m + q]
        return replace(self, A=both.A, B=b, E=e, F=both.C[p:], G=g, H=late)

    @property
    def _seen(self) -> tuple[Array, Array]:
        """C and D of y and z together."""
        return np.vstack([self.C, self.F]), np.vstack([self.D, self.G])

    def _around(self, late: LinearBlock, e: Array) -> FeedbackBlock:
        """Return the same loop around a block whose outputs are y and z, which w enters by E."""
        p = self.n_outputs
        c, d = (late.C[:p], late.C[p:]), (late.D[:p], late.D[p:])
        return replace(self, A=late.A, B=late.B, C=c[0], D=d[0], E=e, F=c[1], G=d[1])

    def observed_by(self, sensor: LinearBlock) -> FeedbackBlock:
        """Series with a sensor; the outputs are first this block's own, then the sensor's."""
        both = LinearBlock(self.A, self.B, self.C, self.D, self.sample_time_s).observed_by(sensor)
        more = len(sensor.A)
        e = np.vstack([self.E, np.zeros((more, self.E.shape[1]))])
        f = np.hstack([self.F, np.zeros((len(self.F), more))])
        return replace(self, A=both.A, B=both.B, C=both.C, D=both.D, E=e, F=f)

    def delayed(self, samples: int) -> FeedbackBlock:
        """Delay the input by whole samples (a shift register in front)."""
        if samples == 0:
            return self
        late = LinearBlock(self.A, self.B, *self._seen, self.sample_time_s).delayed(samples)
        more = len(late.A) - len(self.A)
        return self._around(late, np.vstack([np.zeros((more, self.E.shape[1])), self.E]))

    def rest(self) -> Array:
        """State of a block that was never driven."""
        n = len(self.A)
        if isinstance(self.hysteresis, PrandtlIshlinskii):
            return np.zeros(n + self.hysteresis.bank.r.size)
        return np.concatenate([np.zeros(n), self.packing.numbers(self.hysteresis.rest().as_dict())])

    @cached_property
    def packing(self) -> Packing:
        """Where the numbers of Gamma's memory stand in the state."""
        from hammerstein.blocks.block_system import Packing  # it brings python-control

        return Packing(self.hysteresis.rest().as_dict())

    def carry_on(self, u_v: Array, state: Array, first: int, stop: int, y_um: Array) -> None:
        """Put outputs into y_um (p, sample) from one sample up to another; ``state`` is moved on."""
        n, inside = len(self.A), isinstance(self.hysteresis, PrandtlIshlinskii)
        memory = None if inside else self.hysteresis.restore(self.packing.data(state[n:]))
        gamma = self._plays(state[n:]) if inside else self.hysteresis.in_loop(memory)
        if gamma is None:
            self._step_by_step(u_v, state, first, stop, y_um)
            return
        from hammerstein.dynamics.feedback_kernel import respond_loop

        curved = self.products.limit, self.products.factors, self.products.weights
        given, weights = (*self.entries, self.push, gamma, *curved, state[:n], u_v), self.hysteresis.weights
        for start, end in spans(stop - first, len(self.entries[2]) + self.push.size + sum(map(len, weights))):
            respond_loop(*given, first + start, first + end, y_um)
        if memory is not None:
            state[n:] = self.packing.numbers(memory.as_dict())

    def _plays(self, held: Array) -> tuple[Any, ...]:
        """Plays one by one, which stand at some voltages (number,)."""
        from hammerstein.hysteresis.loop_kernels import Plays

        assert isinstance(self.hysteresis, PrandtlIshlinskii)
        bank = self.hysteresis.bank
        return Plays(bank.r, bank.w, self.touched, held.reshape(bank.r.shape))

    @cached_property
    def touched(self) -> Indices:
        """First and last + 1 of the outputs (h, 2) of plays that an input moves: most move one."""
        assert isinstance(self.hysteresis, PrandtlIshlinskii)
        moved = [np.flatnonzero(w.any(axis=0)) for w in self.hysteresis.bank.w]
        return np.array([(own[0], own[-1] + 1) if len(own) else (0, 0) for own in moved], dtype=np.int64)

    def _step_by_step(self, u_v: Array, state: Array, first: int, stop: int, y_um: Array) -> None:
        """Any kind of hysteresis, one sample after the other."""
        n = len(self.A)
        x, memory = state[:n].copy(), self.hysteresis.restore(self.packing.data(state[n:]))
        for t in range(first, stop):
            u = u_v[:, t]
            y_um[:, t] = self.C @ x + self.D @ u
            z, w = self.F @ x + self.G @ u, np.zeros(0)
            for move in z.reshape(self.moves, -1):
                z_now = move + self.H @ w if len(w) else move
                more, memory = self.hysteresis.step(z_now, memory)
                w = np.concatenate([w, more + self.products.at(z_now)])
            x = self.A @ x + self.B @ u + self.E @ w
        state[:n], state[n:] = x, self.packing.numbers(memory.as_dict())

    @cached_property
    def entries(self) -> tuple[Indices, Indices, Array]:
        """Non-zero entries of [[F, G, late], [A, 0, 0], [C, D, 0]] row by row."""
        n, (m, width) = self.n_inputs, (self.n_outputs, self.E.shape[1])
        rows = [[self.F, self.G, self.late], [self.A, np.zeros((len(self.A), n + width))]]
        return entries_of(np.block([*rows, [self.C, self.D, np.zeros((m, width))]]))

    @cached_property
    def push(self) -> Array:
        """[B, E] turned (inputs and w, n), whose entries are filled."""
        return np.ascontiguousarray(np.hstack([self.B, self.E]).T)


def _held_and_rising(a: Array, e: Array, sample_time_s: float) -> tuple[Array, Array]:
    """What a held w, and one that rises from 0 to 1 in a sample, add to the x of x' = a x + e w.

    Source: C. F. Van Loan, IEEE Transactions on Automatic Control 23 (1978) 395-404.
    """
    from scipy.linalg import expm

    n, q = e.shape
    whole = np.zeros((n + 2 * q, n + 2 * q))
    whole[:n, : n + q] = np.hstack([a, e])
    whole[n : n + q, n + q :] = np.eye(q) / sample_time_s
    step = expm(whole * sample_time_s)
    return step[:n, n : n + q], step[:n, n + q :]
