"""A block of one kind fitted to records, with everything else known, for the tests of several kinds."""

import numpy as np

from hammerstein.identification.behind import Behind
from hammerstein.identification.choices import identifiable_kinds
from hammerstein.identification.kinds import driven_of
from hammerstein.identification.projection import fit_block
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.task import Task


def fit_kind(
    kind,
    records,
    *,
    grids=None,
    invertible=True,
    starts=(),
    delay_samples=0,
    axes=(),
    like=None,
    refined=True,
):
    """Block of a kind with thresholds (input,), behind known axes if there are any."""
    solver = "invertible" if invertible else "least_squares"
    settings = Settings(hysteresis=kind, solver=solver, delay_samples=delay_samples, error_curve=False)
    begun = tuple(starts) or (Start("rest"),) * len(records)
    row = grids or [np.zeros(1) for _ in records[0].u_v]
    thresholds_v = [list(row) for _ in records[0].y_um]
    task = Task(tuple(records), begun, thresholds_v, delay_samples, settings, lambda _: None)
    driven = driven_of(task, thresholds_v)
    begins = [like] if like is not None else identifiable_kinds()[kind].first_guesses(driven)
    return fit_block(task, begins, driven, Behind(tuple(axes), delay_samples), refined=refined)
