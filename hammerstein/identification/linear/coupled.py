"""Linear blocks that couple the outputs: state-space model and static block in front of it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from hammerstein.arrays import Array, Complex
from hammerstein.dynamics import LinearBlock, StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.linear.frequency_response import FrequencyResponse, frequency_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.identification.score import Candidate
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


def measured_response(records: Sequence[Record], v_um: Sequence[Array] | None = None) -> FrequencyResponse:
    """Frequency response from the voltages, or from the output of the static block, to the readings."""
    period = records[0].period_samples
    same = all(record.period_samples == period for record in records)
    return frequency_response(
        [record.u_v for record in records] if v_um is None else list(v_um),
        [record.y_um for record in records],
        records[0].sample_time_s,
        period_samples=period if same else None,
    )


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
