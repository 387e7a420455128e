"""How far the parameters of an axis move when the hysteresis in front of it may follow another law.

The residual of a least-squares fit is orthogonal to its derivatives. An error of the hysteresis that a
resonance or a low-pass has taken up is therefore not in the residual, and no covariance of the residual shows
it, whatever correlation it allows for. A wider model does: the parameters move as soon as something else can
explain the same (Hausman, Econometrica 46 (1978) 1251-1271).

The wider model has columns of two other families beside those of the model: plays of each input with their
squares and cubes, because a Preisach operator is a sum of functions of plays (Brokate and Sprekels,
Hysteresis and Phase Transitions, 1996, section 2.4), and Bouc-Wen loops, which have no return-point memory.
Each column may be as large as the part of the residual that is no noise: if the residual is noise, nothing
moves.
"""

import itertools
from collections.abc import Iterator

import numpy as np

from hammerstein.arrays import Array
from hammerstein.hysteresis import BoucWen, BoucWenPair, Pair, PrandtlIshlinskii
from hammerstein.hysteresis.bouc_wen import FIRST_RATES, FIRST_SHARES
from hammerstein.identification.model_selection import behind_path
from hammerstein.identification.score import Candidate, columns_of
from hammerstein.identification.static.regressors import InitialState, Regressors
from hammerstein.records.record import Record

PLAYS, POWERS = 8, (1, 2, 3)
"""Plays of each input, from a threshold of 0 to an eighth below half the swing, and the powers of each.
Together with the loops they leave at most a sixth of the misfit of random actuators of five laws."""


def moved_beside_other_laws(
    fitted: Array, weights: Array, others: Array, left: Array, penalties: Array, misfit: float, noise: float
) -> Array:
    """Change of fitted parameters (number,) when other columns may explain the residual as well.

    With the weights eliminated, d and c minimise

        |e - S d - E c|^2 / s^2 + sum (d / scale)^2 + sum c^2 / t^2

    with the derivatives S of the output by the parameters and the other columns E, each of unit power.

    Parameters
    ----------
    fitted, weights, others : (row, sample) S, the columns of the weights, and E
    left : (sample,) residual e [um]
    penalties : (number,) 1 / scale^2
    misfit : t^2, the part of the variance of the residual that is no noise [um^2]
    noise : s^2, variance of the residual [um^2]
    """
    basis, _ = np.linalg.qr(weights.T)
    rows = np.vstack([fitted, others / np.sqrt(np.mean(others**2, axis=1, keepdims=True))])
    rows = rows - (rows @ basis) @ basis.T
    more = np.full(len(others), 1.0 / misfit)
    information = rows @ rows.T + noise * np.diag(np.concatenate([penalties, more]))
    return np.asarray(np.linalg.solve(information, rows @ left)[: len(fitted)])


def other_columns(
    candidate: Candidate, record: Record, start: InitialState, swing_v: Array
) -> Iterator[list[Array]]:
    """Groups of other columns (output) (column, sample) behind the linear block, each about its mean.

    swing_v : (input,) half swing of each input in all records [V]
    """
    for raw in _other_laws(record, start, np.where(swing_v > 0.0, swing_v, 1.0)):
        group = []
        for o in range(len(record.y_um)):
            passed = np.hstack([x for _, x in behind_path(candidate, record, start, o, raw)])
            group.append(passed - passed.mean(axis=1, keepdims=True))
        yield group


def _other_laws(record: Record, start: InitialState, swing_v: Array) -> Iterator[Regressors]:
    """Powers of plays of all inputs, and Bouc-Wen loops of nine shapes, in parts of the half swings."""
    row = tuple(Pair(v / PLAYS * np.arange(PLAYS), np.ones(PLAYS)) for v in swing_v.tolist())
    plays, size = columns_of(PrandtlIshlinskii((row,)), record, start, 0), np.repeat(swing_v, PLAYS)
    for power in POWERS:
        yield Regressors((plays.values / size[:, None]) ** power, (plays.held / size) ** power)
    for rate, share in itertools.product(FIRST_RATES, FIRST_SHARES):
        loads = (rate / swing_v).tolist()
        loops = tuple(BoucWenPair(1.0, 1.0, share * load, (1.0 - share) * load) for load in loads)
        both = columns_of(BoucWen((loops,)), record, start, 0)
        yield Regressors(both.values[1::2] / swing_v[:, None], both.held[1::2] / swing_v)
