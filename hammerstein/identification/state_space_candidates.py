"""Candidate models with a linear block in state space, which may couple the outputs."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from hammerstein.arrays import Array, Complex
from hammerstein.dynamics import LinearBlock, StateSpaceDynamics, StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.fit import CandidateSet, FittedModel, Kind, Task, WeightFits
from hammerstein.identification.linear.frequency_response import measured_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.identification.model_selection import FELT, lowers
from hammerstein.identification.play_candidates import build_static, without_dynamics
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.static.normal_equations import Bounds, Moments, pooled, solve
from hammerstein.identification.static.regressors import InitialState, PlayColumns
from hammerstein.identification.static.static_block import (
    SlopeColumns,
    SquaresSolver,
    StaticFit,
    Thresholds,
    as_block,
    bounds_of,
    gains_of,
    record_moments,
    refuse_unreached,
    ridge_of,
)
from hammerstein.records.record import Record


def fit_linear(
    records: Sequence[Record], order: int, progress: Callable[[str], None] | None = None
) -> tuple[LinearBlock, Array]:
    """State-space model (p inputs, p outputs) and the gain matrix (output, input) in front of it.

    The gain is that of the model at its lowest line, so the block itself has unit gain there.

    Raises
    ------
    IdentificationError : more inputs than outputs, or an excitation that does not determine the response
    """
    m, p = len(records[0].u_v), len(records[0].y_um)
    if m > p:
        raise IdentificationError(
            f"a state-space block after a static block with {p} outputs cannot use {m} inputs; use "
            "second_order dynamics, or measure more outputs"
        )
    response = measured_response(records)
    block = fit_state_space(response, order, progress=progress)
    gain = block.response(response.frequency_hz[:1])[0].real
    return behind_gain(block, gain), gain


def behind_gain(block: LinearBlock, gain: Array) -> LinearBlock:
    """Split a block into a gain (p, m) and the block behind it."""
    inverse = np.linalg.pinv(gain)
    return LinearBlock(block.A, block.B @ inverse, block.C, block.D @ inverse, block.sample_time_s)


def refit_linear(
    records: Sequence[Record],
    starts: Sequence[InitialState],
    hysteresis: PrandtlIshlinskii,
    order: int,
    progress: Callable[[str], None] | None = None,
) -> LinearBlock:
    """State-space model behind a known static block."""
    static = Candidate(hysteresis, StaticDynamics(n_outputs=hysteresis.n_outputs))
    outputs = [static.predict(record, start) for record, start in zip(records, starts, strict=True)]
    return fit_state_space(measured_response(records, outputs), order, progress=progress)


@dataclass(frozen=True, eq=False)
class ModalCopies:
    """Copies of a path with one input and one output, one for each column, mode by mode.

    poles, residues_in, residues_out : (mode,) one of each conjugate pair; through : direct gain
    """

    poles: Complex
    residues_in: Complex
    residues_out: Complex
    through: float

    @classmethod
    def of(cls, block: LinearBlock, output: int, input_: int) -> ModalCopies:
        """Path of a block from one input to one output."""
        poles, vectors = (part.astype(np.complex128) for part in np.linalg.eig(block.A))
        b = np.linalg.solve(vectors, block.B[:, input_])
        c = block.C[output] @ vectors
        upper = poles.imag >= 0.0
        twice = np.where(poles.imag > 0.0, 2.0, 1.0)
        return cls(poles[upper], b[upper], (twice * c)[upper], float(block.D[output, input_]))

    def settled(self, columns: Array) -> Complex:
        """State (copy, mode) of paths that were held at their column for ever."""
        return np.asarray(np.outer(columns, self.residues_in / (1.0 - self.poles)), dtype=np.complex128)

    def respond(self, columns: Array, start: Complex) -> tuple[Array, Complex]:
        """Outputs (copy, sample) and the state after them."""
        from hammerstein.dynamics.path_kernel import respond_modes

        state, passed = start.copy(), np.empty_like(columns)
        respond_modes(self.poles, self.residues_in, self.residues_out, self.through, state, columns, passed)
        return passed, state


def fit_static_coupled(
    records: Sequence[Record],
    thresholds_v: Thresholds,
    through: LinearBlock,
    starts: Sequence[InitialState],
    *,
    solver: SquaresSolver = "invertible",
    ridge: float = 0.0,
) -> StaticFit:
    """Weights in front of a linear block that couples the outputs: all are unknowns of one problem.

    Every output counts in parts of its own power. See ``fit_static`` for the arguments.
    """
    layout = SlopeColumns.of(thresholds_v)
    refuse_unreached(records, layout.grids)
    outputs = _moments(records, starts, layout, through)
    merge, freedom = np.asarray(block_diag(*layout.merge)), sum(moment.freedom for moment in outputs)
    gram, cross = _joint(merge, outputs)
    ends = np.cumsum([0, *(row[-1].stop for row in layout.parts)]).tolist()
    own = [slice(*both) for both in itertools.pairwise(ends)]  # unknowns of each output
    ridges = [ridge_of(row, gram[s, s], ridge) for row, s in zip(layout.parts, own, strict=True)]
    penalty = np.asarray(block_diag(*ridges)) if ridge > 0.0 else None
    known = gram, cross, float(len(outputs)), freedom
    free = found = solve(*known, penalty=penalty)
    if solver != "least_squares":
        gains = gains_of(records, thresholds_v, layout, [free.coefficients[s] for s in own])
        each = [bounds_of(solver, layout, o, gains) for o in range(len(outputs))]
        bounds = Bounds(
            np.asarray(block_diag(*[b.basis for b in each])),
            np.concatenate([b.side for b in each]),
            np.concatenate([b.bound for b in each]),
        )
        found = solve(*known, bounds=bounds, penalty=penalty)
    c = merge @ found.coefficients
    left = [(m.power[0] - 2.0 * m.cross[:, 0] @ c + c @ m.gram @ c) / m.freedom for m in outputs]
    rms_um = np.sqrt(np.maximum(left, 0.0)).tolist()
    solutions = [found.of_output(*both) for both in zip(own, rms_um, strict=True)]
    without = [free.of_output(*both) for both in zip(own, rms_um, strict=True)]
    return as_block(thresholds_v, layout, without, solutions, [c] * len(outputs), outputs)


def _joint(merge: Array, outputs: Sequence[Moments]) -> tuple[Array, Array]:
    """Moments of one problem for the slopes of all outputs: with each other, and with the readings."""
    weight = [1.0 / max(float(moment.power[0]), np.finfo(float).tiny) for moment in outputs]
    gram = np.sum([w * m.gram for w, m in zip(weight, outputs, strict=True)], axis=0)
    cross = np.sum([w * m.cross[:, 0] for w, m in zip(weight, outputs, strict=True)], axis=0)
    return merge.T @ gram @ merge, merge.T @ cross


def _moments(
    records: Sequence[Record], starts: Sequence[InitialState], layout: SlopeColumns, through: LinearBlock
) -> list[Moments]:
    """Moments of each output with the columns of all outputs of the static block."""
    outputs = range(len(records[0].y_um))
    filters = [[ModalCopies.of(through, o, k) for k in outputs] for o in outputs]
    held = np.ones(len(outputs) * sum(map(len, layout.grids)), dtype=np.bool_)
    parts = []
    for record, start in zip(records, starts, strict=True):
        plays = partial(PlayColumns.of, record.u_v, start, layout.grids)
        parts.append(record_moments(record, start, plays, filters, held))
    return [pooled(part) for part in zip(*parts, strict=True)]


MOST_ROUNDS = 8
"""Most times that the two blocks are fitted in turn; each must gain a fiftieth."""
PATIENCE = 2
"""Orders in a row that lower the error no more, after which they end."""
ORDERS = (1, 2, 3, 4, 6, 8, 12)
"""States for each output that are tried where no order is given."""


@dataclass(frozen=True, eq=False)
class StateSpaceTrial:
    """A state-space model of some order: alone, and behind a static block."""

    order: int
    alone: Candidate
    blocks: WeightFits
    best: Candidate
    error: float


def build_state_space(task: Task) -> CandidateSet:
    """All four kinds, with a state-space model of the requested order, or of the lowest sufficient one."""
    static = build_static(without_dynamics(task))
    trials = _orders_tried(task)
    least = min(trial.error for trial in trials)
    begun = next(trial for trial in trials if trial.error <= least / (1.0 - FELT))
    blocks, best = _in_turn(task, begun)
    found: dict[Kind, FittedModel] = {
        **static.found,
        "linear_dynamics": FittedModel(begun.alone, static.found["linear"].blocks),
        "hammerstein": FittedModel(best, blocks),
    }
    rest = [trial for trial in trials if trial is not begun]
    others = tuple((f"state space of order {one.order}", FittedModel(one.best, one.blocks)) for one in rest)
    return CandidateSet(found, "hammerstein", others=others)


def _orders_tried(task: Task) -> list[StateSpaceTrial]:
    """Models of the order asked for, or of growing orders until two in a row lower the error no more."""
    order = task.settings.order
    if order is not None:
        return [_of_order(task, order)]
    trials: list[StateSpaceTrial] = []
    for states in ORDERS:
        try:
            trials.append(_of_order(task, states * task.outputs))
        except IdentificationError:  # more states than the lines of the response can tell
            if not trials:
                raise
            break
        errors = [trial.error for trial in trials]
        if len(errors) - 1 - int(np.argmin(errors)) >= PATIENCE:
            break
    return trials


def _of_order(task: Task, order: int) -> StateSpaceTrial:
    task.progress(f"fitting linear dynamics of order {order}")
    block, gain = fit_linear(task.records, order, task.progress)
    task.progress("fitting the static block in front of them")
    blocks, best = _hammerstein(task, block)
    alone = task.candidate(gain_model(gain), state_space(block))
    return StateSpaceTrial(order, alone, blocks, best, _error(task, best))


def _in_turn(task: Task, begun: StateSpaceTrial) -> tuple[WeightFits, Candidate]:
    """Linear dynamics and static block fitted in turn, as long as that lowers the error."""
    blocks, best, error, before = begun.blocks, begun.best, begun.error, _error(task, begun.alone)
    told = len(task.records[0].u_v) == task.outputs  # or the outputs of the static block move together
    for _ in range(MOST_ROUNDS if told else 0):
        if not lowers(error, before):
            break
        task.progress("fitting the linear dynamics behind the static block")
        hysteresis = blocks.chosen.hysteresis
        again = refit_linear(task.records, task.starts, hysteresis, begun.order, task.progress)
        trial = _hammerstein(task, again)
        before, now = error, _error(task, trial[1])
        if now < error:
            (blocks, best), error = trial, now
    return blocks, best


def _error(task: Task, candidate: Candidate) -> float:
    return score(candidate, task.records, task.starts).mean_percent


def _hammerstein(task: Task, block: LinearBlock) -> tuple[WeightFits, Candidate]:
    """Static block in front of a linear one."""
    solver = task.settings.solver
    weighting: SquaresSolver = "invertible" if solver == "closed_form" else solver
    found = fit_static_coupled(
        task.records, task.thresholds_v, block, task.starts, solver=weighting, ridge=task.settings.ridge
    )
    return WeightFits(found, found, None), task.candidate(found.hysteresis, state_space(block))


def gain_model(gain: Array) -> PrandtlIshlinskii:
    """Static block of gains (output, input) [um/V] without hysteresis."""
    return PrandtlIshlinskii.from_arrays(np.zeros(1), gain[:, :, None])


def state_space(block: LinearBlock) -> StateSpaceDynamics:
    """Dynamics of a linear block."""
    rows = {name: tuple(map(tuple, getattr(block, name).tolist())) for name in "ABCD"}
    return StateSpaceDynamics(**rows, sample_time_s=block.sample_time_s)
