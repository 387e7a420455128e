"""Candidate models with and without a linear block in state space."""

from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import LinearBlock, StateSpaceDynamics
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.coupled import fit_linear, fit_static_coupled, refit_linear
from hammerstein.identification.model_selection import FELT, lowers
from hammerstein.identification.play_candidates import build_static, without_dynamics
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.static.static_block import SquaresSolver
from hammerstein.identification.task import CandidateSet, FittedModel, Task, WeightFits

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
