"""Initialisation of a fit: initial states, delays and thresholds."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from hammerstein.dynamics import StaticDynamics
from hammerstein.identification.fit import Progress, Task
from hammerstein.identification.linear.axis_fit import ROUGHLY, refine, thinning
from hammerstein.identification.linear.axis_task import AxisTask, axis_of, parameters_of
from hammerstein.identification.model_selection import (
    CURVE_SAMPLES,
    CurvePoint,
    enough_operators,
    error_curve,
)
from hammerstein.identification.output_dynamics import OutputDynamics, with_step
from hammerstein.identification.play_candidates import guess_of, late_static
from hammerstein.identification.score import Candidate
from hammerstein.identification.search import TINY
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import (
    ENDS,
    TURN_WORTH,
    decays,
    found_starts,
    judged_starts,
    shortened,
    stepped_from,
    whole_error,
)
from hammerstein.identification.static.normal_equations import Moments, pooled
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import (
    SlopeColumns,
    input_grids,
    refuse_unreached,
    solve_static,
    static_moments,
)
from hammerstein.records.record import Record

DELAY_OPERATORS = 15
"""Number of operators for the estimate of the delay before their number is chosen."""
DEFAULT_OPERATORS, MOST_FITTED = 15, 20
"""Default number of operators, and the largest number of an input with fitted thresholds."""
STEPPED_BEFORE = 0.2  # part of a record that a step lies before it, where the search begins
CREEP_ROUNDS = 6  # in which starts and a slow mode are found in turn
FIRST_OPERATORS = 20  # of the model that tells how records begin
FIRST_SAMPLES = 50_000
"""Operators and samples of the first model, which only determines initial states."""


def _first_starts(
    records: tuple[Record, ...], settings: Settings, guess: OutputDynamics | None = None
) -> tuple[InitialState, ...]:
    """How the records begin, with quick models of the static block behind the axes guessed so far."""
    mode = settings.start_mode
    if mode == "rest":
        return (InitialState("rest"),) * len(records)
    models, settle_s = _FirstModels(records, guess, settings), guess.dynamics.settle_s if guess else 0.0
    return found_starts(records, lambda starts: models.fitted(starts).predict, settle_s, mode)


@dataclass(frozen=True, eq=False)
class _FirstModels:
    """Quick models that find the initial states of the records, with guessed axes if there are any.

    The contribution of a record to the sums depends on its own initial state alone, so it is computed once
    for each.
    """

    records: tuple[Record, ...]
    guess: OutputDynamics | None
    settings: Settings
    gathered: dict[tuple[int, InitialState], list[Moments]] = field(default_factory=dict)

    def fitted(self, starts: Sequence[InitialState]) -> Candidate:
        """Return the model for records that begin in given ways."""
        task = self._task(starts)
        dynamics = self.guess.dynamics if self.guess else StaticDynamics(n_outputs=task.outputs)
        layout = SlopeColumns.of(task.thresholds_v)
        refuse_unreached(task.records, layout.grids)
        paths = task.paths(dynamics)
        parts = []
        for i, (record, start) in enumerate(zip(task.records, task.starts, strict=True)):
            if (i, start) not in self.gathered:
                self.gathered[i, start] = static_moments(
                    [record], layout.grids, [start], task.whole_delay, paths[i : i + 1]
                )
            parts.append(self.gathered[i, start])
        moments = [pooled(part) for part in zip(*parts, strict=True)]
        found = solve_static(task.records, task.thresholds_v, layout, moments, "least_squares")
        return task.candidate(found.hysteresis, dynamics)

    def _task(self, starts: Sequence[InitialState]) -> Task:
        """Beginnings of the records with thresholds and delay of a first look."""
        quick, begun = shortened(self.records, starts, FIRST_SAMPLES)
        delay = self.guess.delay_samples if self.guess else self.settings.delay_samples or 0
        row = input_grids(quick, FIRST_OPERATORS, "voltage")
        return Task(quick, begun, [list(row) for _ in quick[0].y_um], delay, self.settings, lambda _: None)


def first_task(
    records: tuple[Record, ...], settings: Settings, tell: Progress
) -> tuple[Task, OutputDynamics | None, tuple[CurvePoint, ...]]:
    """Initial states, delays and thresholds of the records, and approximate axes."""
    tell("estimating the initial states")
    begun = _first_starts(records, settings)
    found = guess_of(records, begun, settings, tell) if settings.fast else None
    guess, starts = found, _first_starts(records, settings, found) if found else begun
    if guess and _left_by(records, None, settings, begun) < _left_by(records, guess, settings, starts):
        guess, starts = None, begun  # axes that only do harm would decide on starts and thresholds
    elif starts != begun:
        guess = found = guess_of(records, starts, settings, tell)
    first = _FirstModels(records, guess, settings).fitted(starts)
    settle_s = found.dynamics.settle_s if found else 0.0
    starts = judged_starts(records, first.predict, settle_s, settings.start_mode)
    if guess:
        starts = creeping_starts(records, starts, guess, settings, tell)
    static = _static_delay(records, starts, settings, tell)
    task = Task(records, starts, (), found.delay_samples if found else static, settings, tell, static)
    curve: tuple[CurvePoint, ...] = ()
    wanted = settings.error_curve or (settings.operators == "auto" and settings.thresholds_v is None)
    if wanted and settings.uses_axes:
        tell("trying numbers of operators")
        paths = task.paths(guess.dynamics if guess else first.dynamics)
        place, whole = settings.begun_with, task.whole_delay
        curve = error_curve(records, starts, partition=place, delay_samples=whole, through=paths)
    chosen = enough_operators(curve) if curve else DEFAULT_OPERATORS
    if settings.fits_thresholds and settings.operators == "auto":
        chosen = min(chosen, MOST_FITTED)
    return replace(task, thresholds_v=settings.thresholds(records, chosen)), found, curve


def _left_by(
    records: tuple[Record, ...],
    guess: OutputDynamics | None,
    settings: Settings,
    starts: tuple[InitialState, ...],
) -> float:
    """Mean squared error that a quick model leaves of whole records, in parts of their ranges."""
    return whole_error(records, starts, _FirstModels(records, guess, settings).fitted(starts).predict)


def creeping_starts(
    records: tuple[Record, ...],
    starts: tuple[InitialState, ...],
    guess: OutputDynamics,
    settings: Settings,
    tell: Progress,
) -> tuple[InitialState, ...]:
    """Initial states of records that began during creep of an earlier step, alternating with a slow mode.

    Unchanged if no prediction error decays, or if a slow mode fits as well with records that began at rest.
    """
    quick, begun = shortened(records, starts, FIRST_SAMPLES)
    first = _FirstModels(quick, guess, settings).fitted(begun)
    errors = [first.residual(record, start) for record, start in zip(quick, begun, strict=True)]
    if settings.start_mode != "auto" or settings.creep_modes == 0 or not any(map(decays, errors)):
        return starts
    tell("looking whether the records began while they crept")
    alike = [begun, *(_all_stepped_from(end, quick, begun) for end in ENDS)]
    tried = [(*_creeping_guess(quick, one, guess, settings), one) for one in alike]
    settled = tried[0][0]
    least, creeping, begun = min(tried, key=lambda one: one[0])
    for _ in range(CREEP_ROUNDS):
        model = _FirstModels(quick, creeping, settings).fitted(begun)
        other = judged_starts(quick, model.predict, guess.dynamics.settle_s, "auto", slow_s=model.slow_s)
        rms, near = _creeping_guess(quick, other, creeping, settings)
        if rms >= least:
            break
        (least, creeping), begun = (rms, near), other
    return begun if least**2 < (1.0 - TURN_WORTH) * settled**2 else starts


def _all_stepped_from(
    end: str, records: Sequence[Record], starts: Sequence[InitialState]
) -> tuple[InitialState, ...]:
    """Starts a fifth of a record after a step from one end of the range; those in motion as they are."""
    return tuple(
        start
        if start.kind == "repeated"
        else stepped_from(end, record, round(STEPPED_BEFORE * record.samples))
        for record, start in zip(records, starts, strict=True)
    )


def _creeping_guess(
    records: tuple[Record, ...], starts: tuple[InitialState, ...], guess: OutputDynamics, settings: Settings
) -> tuple[float, OutputDynamics]:
    """Axes with a slow mode near those of a guess, and before them the geometric mean of what they leave."""
    grids, every = tuple(input_grids(records, FIRST_OPERATORS, "voltage")), thinning(records)
    axes, rms = [], []
    for o, axis in enumerate(guess.axes):
        shape, x = parameters_of(axis)
        task = AxisTask(records, starts, grids, o, shape, guess.delay_samples, settings.sensor, every)
        grown = None if shape.creep_modes else with_step(task, shape, x, "creep")
        point = grown or refine(task, x, ROUGHLY)
        axes.append(axis_of(grown.shape if grown else shape, point.x))
        rms.append(max(point.rms, TINY))
    return float(np.exp(np.mean(np.log(rms)))), guess._replace(axes=tuple(axes))


def _static_delay(
    records: tuple[Record, ...], starts: tuple[InitialState, ...], settings: Settings, tell: Progress
) -> int:
    """Delay that suits a model without dynamics, with thresholds that are not fitted yet."""
    if settings.dynamics == "state_space":
        return settings.delay_samples or 0
    tell("estimating the delay")
    few, begun = shortened(records, starts, CURVE_SAMPLES)
    thresholds_v = _fine(settings).thresholds(few, DELAY_OPERATORS)
    return late_static(
        Task(few, begun, thresholds_v, settings.delay_samples or 0, settings, tell)
    ).whole_delay


def _fine(settings: Settings) -> Settings:
    """Settings with so many operators that a delay does not stand in for thresholds that are missing."""
    few = isinstance(settings.operators, int) and settings.operators < DELAY_OPERATORS
    return settings.changed(operators=DELAY_OPERATORS) if few else settings
