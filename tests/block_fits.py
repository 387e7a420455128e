"""A block of one kind fitted to records, with everything else known, for the tests of several kinds."""

import numpy as np

from hammerstein.dynamics import StaticDynamics
from hammerstein.identification.columns import chosen_columns
from hammerstein.identification.fit import Task
from hammerstein.identification.kinds import driven_of
from hammerstein.identification.options import identifiable_kinds
from hammerstein.identification.output_dynamics import OutputDynamics
from hammerstein.identification.projection import fit_block
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState


def task_of(kind, records, *, grids=None, starts=(), delay_samples=0, **options):
    """Task with thresholds (input,), and how its records drive the inputs."""
    given = {} if grids is None else {"thresholds_v": [list(grids) for _ in records[0].y_um]}
    settings = Settings(hysteresis=kind, delay_samples=delay_samples, error_curve=False, **given, **options)
    begun = tuple(starts) or (InitialState("rest"),) * len(records)
    row = [np.zeros(1) for _ in records[0].u_v] if grids is None else grids
    thresholds_v = [list(row) for _ in records[0].y_um]
    task = Task(tuple(records), begun, thresholds_v, delay_samples, settings, lambda _: None)
    return task, driven_of(task, thresholds_v)


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
    ridge=0.0,
):
    """Block of a kind with thresholds (input,), behind known axes if there are any."""
    solver = "invertible" if invertible else "least_squares"
    known = {"grids": grids, "starts": starts, "delay_samples": delay_samples, "solver": solver}
    task, driven = task_of(kind, records, **known)
    begins = [like] if like is not None else identifiable_kinds()[kind].first_guesses(driven)
    found = OutputDynamics(tuple(axes), delay_samples)
    return fit_block(task, begins, driven, found, refined=refined, ridge=ridge)


def columns_for(kind, records, **known):
    """Block with the columns that the records call for, and the ridge."""
    task, driven = task_of(kind, records, **known)
    [first] = identifiable_kinds()[kind].first_guesses(driven)
    return chosen_columns(task, [first], driven, StaticDynamics(n_outputs=task.outputs))
