"""Every kind of hysteresis and the linear models on the same records: which one to take.

Hysteresis in the loop is one more candidate, judged on experiments that it was not fitted to.
"""

import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.blocks.driving import DriveRange
from hammerstein.comparison.fitting import Failed, Fitted, Progress, fit_all
from hammerstein.comparison.result import Compared, Comparison, Left, Unseen
from hammerstein.compensators import Compensator, ExactInverse, HammersteinInverse, InverseMultiplicative
from hammerstein.dynamics import StaticDynamics, discretise, on_grid
from hammerstein.errors import HammersteinError
from hammerstein.identification.excitation import quantile_hz
from hammerstein.identification.identify import from_last_rest
from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from hammerstein.identification.in_loop.search import Selection, settled_periods
from hammerstein.identification.model_selection import Trial, as_good, chosen, least, trial_of
from hammerstein.identification.options import PLAYS
from hammerstein.identification.residual_analysis import record_flags
from hammerstein.identification.score import Score, SensorModel, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.resources import one_blas_thread

ALIKE = 1.1
"""Ratio up to which the frequencies of two records count as one."""
IN_LOOP = "hysteresis in the loop"
HEADROOM = 0.1
"""Part of the recorded range by which the voltages may leave it at either end."""
SETTLING = 0.125
"""Part of a record that is not counted: the way from rest to the path."""
MOST_SAMPLES = 100_000
"""Of a record that is played."""


def frequencies(records: Sequence[Record]) -> list[float]:
    """Frequency [Hz] of each record, the same number for those that are alike; 0 where nothing is driven.

    Examples
    --------
    >>> def sine(hz):
    ...     u = np.sin(2.0 * np.pi * hz * 1e-3 * np.arange(1000))
    ...     return Record([u], [u], 1e-3)
    >>> frequencies([sine(5.0), sine(20.0), sine(5.02)])
    [5.0, 20.0, 5.0]
    """
    own = [quantile_hz(record, 0.5) for record in records]
    groups: list[list[float]] = []
    for hz in sorted(own):
        if groups and hz <= ALIKE * groups[-1][0]:
            groups[-1].append(hz)
        else:
            groups.append([hz])
    return [next(float(f"{np.mean(group):.3g}") for group in groups if hz in group) for hz in own]


def scores_at(
    one: Fitted, own: Sequence[float], records: Sequence[Record], starts: Sequence[InitialState]
) -> dict[float, Score]:
    """Errors of a model on the records of each of their own frequencies, lowest first."""
    pairs = list(zip(records, starts, strict=True))
    found = {}
    for hz in sorted(set(own)):
        there = [pair for pair, f in zip(pairs, own, strict=True) if f == hz]
        found[hz] = score(one.candidate, *zip(*there, strict=True))
    return found


class Inverse(NamedTuple):
    """The best law for a model: an exact inverse, else one without inversion, else none.

    options : the law; None if none works; exact : whether it inverts the model
    words : description, or the reason why there is none
    """

    options: Compensator | None
    exact: bool
    words: str


def inverse_of(model: HammersteinModel, sample_time_s: float) -> Inverse:
    """The law for a model, exact if the model has an inverse."""
    static = isinstance(model.dynamics, StaticDynamics) and not model.dynamics.input_delay_s
    exact: Compensator = ExactInverse() if static else HammersteinInverse()
    try:
        exact.design(model, _range(model), sample_time_s)
        return Inverse(exact, True, exact.law)
    except HammersteinError as error:
        why = str(error).removeprefix(f"{exact.law}: ")
    try:
        other = InverseMultiplicative()
        other.design(model, _range(model), sample_time_s)
        return Inverse(other, False, f"{other.law}; no exact inverse: {why}")
    except HammersteinError:
        return Inverse(None, False, f"none: {why}")


def _range(model: HammersteinModel) -> DriveRange:
    """Range of the records and a little more."""
    low, high = np.array(model.recorded.lowest_v), np.array(model.recorded.highest_v)
    more = HEADROOM * (high - low)
    return DriveRange.of(np.stack([low - more, high + more], axis=1), model)


def left_by(one: Fitted, law: Inverse, other: Fitted, records: Sequence[Record]) -> Left:
    """Error of the compensator of one model on another model.

    The path is the response of the other model to the voltages of the records, from rest. The law of the
    first model computes the voltages for this path, and the other model responds to them.

    other : the model that predicts best, the same for all; it has no error itself
    """
    if law.options is None:
        return Left(reason=law.words)
    if other is one:
        return Left(law.options.law, reason="this model replaces the actuator")
    errors, spans, held = [], [], []
    try:
        for record in records:
            error, span, at_range = _played(one.model, law.options, other.model, record)
            errors.append(error)
            spans.append(span)
            held.append(at_range)
    except HammersteinError as error:
        return Left(law.options.law, other.name, reason=str(error))
    percent = 100.0 * np.sqrt(np.mean(np.hstack(errors) ** 2, axis=1)) / np.max(spans, axis=0)
    at_range = float(np.mean(np.concatenate(held)))
    return Left(law.options.law, other.name, float(percent.mean()), 100.0 * at_range)


def _played(
    model: HammersteinModel, options: Compensator, other: HammersteinModel, record: Record
) -> tuple[Array, Array, Any]:
    """Error about its mean (output, sample), range of the path (output,) and where the range was reached."""
    part = record.part(0, min(record.samples, MOST_SAMPLES))
    sample_time_s = part.sample_time_s
    first = int(SETTLING * part.samples)
    path = other.simulate(part.u_v + part.rest_v[:, None], sample_time_s).position_um
    law: Law[Any] = options.design(model, _range(model), sample_time_s)  # type: ignore[assignment]  # none of them is a controller
    drive = law.drive_for(path)
    error = (other.simulate(drive, sample_time_s).position_um - path)[:, first:]
    at_range = law.range.reached(drive)[:, first:].any(axis=0)
    return error - error.mean(axis=1, keepdims=True), np.ptp(path[:, first:], axis=1), at_range


@dataclass(frozen=True, eq=False)
class LoopFit:
    """Hysteresis in the loop, and the errors of every model on experiments that it was not fitted to.

    records : fitted and validation records of its own errors: settled periods count from one voltage
    trials : of the other models, then its own; only the others were fitted to these experiments
    """

    fitted: Fitted
    inverse: Inverse
    records: tuple[tuple[Record, ...], tuple[Record, ...]]
    trials: tuple[Trial, ...]

    @property
    def trial(self) -> Trial:
        """Its own errors."""
        return self.trials[-1]

    @property
    def wins(self) -> bool:
        """Whether no other model is as good or has its error with fewer parameters."""
        return chosen(self.trials) == len(self.trials) - 1

    @property
    def good(self) -> set[str]:
        """Names of the models whose errors there are the least, or hardly above it."""
        return {self.trials[i].name for i in as_good(self.trials)}

    def unseen(self) -> Unseen:
        """Its error and that of the best other model."""
        rival = self.trials[least(self.trials[:-1])]
        return Unseen(IN_LOOP, self.trial.percent, rival.name, rival.percent, len(self.trial.squares))


def fit_in_loop(
    records: Sequence[Record],
    settings: LoopSettings,
    validation: Sequence[Record],
    others: Sequence[tuple[Fitted, Trial]],
    progress: Callable[[str], None],
) -> LoopFit | Failed:
    """Identify hysteresis in the loop, and judge all models on a third of the experiments.

    They choose its structure and its number of steps, with parameters that are fitted to the other
    experiments. The other models were fitted to all of them, so that an advantage of the loop is no part of
    the fit.

    others : the other models, and their errors where they are judged among themselves
    """
    begun = time.process_time()
    try:
        model, fit = identify_in_loop(
            records, settings, validation=validation, name=IN_LOOP, progress=progress
        )
    except HammersteinError as error:
        return Failed(IN_LOOP, PLAYS, str(error))
    seconds = time.process_time() - begun
    ours = Fitted(
        IN_LOOP, PLAYS, model, fit.candidates["in_loop"], fit.starts, fit.held_starts, fit.flags, seconds
    )
    inverse = inverse_of(model, fit.sample_time_s)
    block = discretise(fit.candidates["linear_dynamics"].dynamics, fit.sample_time_s)
    parts = Selection.of(settled_periods(fit.records, block.respond))
    ideal = [(replace(one.candidate, sensor=SensorModel()), trial) for one, trial in others]
    trials = [parts.of_model(candidate, trial, fit.records[0]) for candidate, trial in ideal]
    own = next(trial for trial in fit.trials if trial.kept)
    trials.append(replace(own, name=IN_LOOP, usable=inverse.exact, kept=False))
    return LoopFit(ours, inverse, (fit.records, fit.held), tuple(trials))


TIMED_SAMPLES = 20_000  # long beside the clock's step
REPEATS = 5
"""Samples of the forward model that are timed, and how often; the shortest time counts."""


@one_blas_thread()
def compare(
    records: Sequence[Record],
    settings: Settings | None = None,
    *,
    validation: Sequence[Record] = (),
    in_loop: LoopSettings | None = None,
    jobs: Jobs = 1,
    progress: Progress | None = None,
) -> Comparison:
    """Fit every kind of hysteresis and the linear models to the same records, and recommend one.

    Plays are fitted once. Each other kind then begins with them, and is fitted without a linear block and
    with its own. Limits of a kind are listed with it. All compensators drive the same model, the best one.

    Parameters
    ----------
    records : experiments on one actuator, as for ``identify``
    settings : how each kind is identified; its ``hysteresis`` and ``dead_zones`` are not used
    validation : validation records: reported, never used to choose
    in_loop : also try hysteresis in the loop of a state space, as ``identify_in_loop`` does; it takes
        minutes. What is known of the sensor, and ``accept_order``, are those of ``settings``
    jobs : number of parallel processes, or an executor of ``concurrent.futures``
    progress : called with the current step, the number of finished identifications, and their total

    Returns
    -------
    errors, parameters, times, inverses, and the recommendation by ``result.RULE``

    Raises
    ------
    InputError : records that do not fit together
    IdentificationError : records that determine no model of any kind

    Examples
    --------
    >>> from hammerstein.hysteresis import Pair, PrandtlIshlinskii
    >>> u = 4.0 * np.sin(2.0 * np.pi * np.arange(1200) / 300) * np.linspace(1.0, 0.5, 1200)
    >>> truth = PrandtlIshlinskii([[Pair([0.0, 1.0, 2.0], [3.0, 1.0, 1.0])]])
    >>> record = Record([u], truth.respond([u])[0], 1e-3)
    >>> found = compare([record], Settings(thresholds_v=[0.0, 1.0, 2.0], dynamics="none"))
    >>> found.recommended
    'prandtl_ishlinskii'
    >>> found["linear gain"].parameters, found["prandtl_ishlinskii"].parameters
    (1, 6)
    """
    tell = progress or (lambda what, done, total: None)
    settings = settings or Settings()
    ready = from_last_rest(records, settings.sensor, accept_order=settings.accept_order)
    held = (
        from_last_rest(validation, settings.sensor, accept_order=settings.accept_order) if validation else ()
    )
    fitted, failed = fit_all(records, settings, validation, jobs, tell)
    tell("playing the compensators", 1, 1)
    grid_s = ready[0].sample_time_s
    inverses = [inverse_of(one.model, grid_s) for one in fitted]
    starts = _own([one.starts for one in fitted], fitted, ready, settings)
    held_starts = _own([one.held_starts for one in fitted], fitted, held, settings)
    each = zip(fitted, starts, held_starts, strict=True)
    fitted = [replace(one, starts=own, held_starts=other) for one, own, other in each]
    trials = [
        trial_of(one.name, one.candidate, ready, one.starts, invertible=inverse.exact)
        for one, inverse in zip(fitted, inverses, strict=True)
    ]
    best, taken = fitted[least(trials)], fitted[chosen(trials)]
    good = {fitted[i].name for i in as_good(trials)}
    others = list(zip(fitted, trials, strict=True))
    loop = in_loop and fit_in_loop(
        records,
        in_loop.with_sensor(settings),
        validation,
        others,
        lambda text: tell(f"{IN_LOOP}: {text}", 1, 1),
    )
    if isinstance(loop, Failed):
        failed.append(loop)
    elif loop and loop.wins:
        best, taken, good = loop.fitted, loop.fitted, loop.good
    elif loop:
        good |= loop.good & {IN_LOOP}
    own = frequencies(ready), frequencies(held)
    entries = [
        _entry(one, inverse, trial, one.name in good, best, (ready, held), own)
        for one, inverse, trial in zip(fitted, inverses, trials, strict=True)
    ]
    if isinstance(loop, LoopFit):
        entries.append(
            _entry(loop.fitted, loop.inverse, loop.trial, IN_LOOP in good, best, loop.records, own)
        )
    return Comparison(
        tuple(sorted(entries, key=lambda entry: entry.parameters)),
        tuple(failed),
        best.name,
        taken.name,
        records[0].inputs,
        records[0].outputs,
        tuple(PurePath(record.source).name for record in records),
        tuple(PurePath(record.source).name for record in validation),
        loop.unseen() if isinstance(loop, LoopFit) else None,
    )


def _own(
    starts: Sequence[Sequence[InitialState]],
    fitted: Sequence[Fitted],
    records: Sequence[Record],
    settings: Settings,
) -> list[tuple[InitialState, ...]]:
    """Start of each record that suits each model, on the samples that count for all of them."""
    first = [max(begun.first for begun in each) for each in zip(*starts, strict=True)]
    found = []
    for own, one in zip(starts, fitted, strict=True):
        alike = [replace(start, first=k) for start, k in zip(own, first, strict=True)]
        found.append(one.candidate.own_starts(records, alike, settings.start_mode))
    return found


def _entry(
    one: Fitted,
    inverse: Inverse,
    trial: Trial,
    good: bool,
    best: Fitted,
    records: tuple[tuple[Record, ...], tuple[Record, ...]],
    own: tuple[Sequence[float], Sequence[float]],
) -> Compared:
    """All results of one model.

    records, own : fitted and validation records, and the frequency of each; those of all models are alike
    """
    ready, held = records
    missed = record_flags(one.candidate, [*ready, *held], [*one.starts, *one.held_starts])
    return Compared(
        name=one.name,
        hysteresis=one.hysteresis,
        dynamics=one.model.dynamics.describe(),
        parameters=trial.parameters,
        fitted=score(one.candidate, ready, one.starts),
        validation=score(one.candidate, held, one.held_starts) if held else None,
        fitted_at=scores_at(one, own[0], ready, one.starts),
        validation_at=scores_at(one, own[1], held, one.held_starts),
        folds_percent=trial.percent,
        as_good=good,
        seconds=one.seconds,
        ns_a_sample=ns_a_sample(one.model, ready[0]),
        has_inverse=inverse.exact,
        inverse=inverse.words,
        left=left_by(one, inverse, best, held or ready),
        flags=tuple(dict.fromkeys([*one.flags, *missed])),
        model=one.model,
    )


def ns_a_sample(model: HammersteinModel, record: Record) -> float:
    """Time of one sample of hysteresis and linear block, all axes together [ns]; the shortest of five."""
    u = np.tile(record.u_v, -(-TIMED_SAMPLES // record.samples))[:, :TIMED_SAMPLES]
    hysteresis = model.hysteresis.on_grid(record.sample_time_s)
    block = on_grid(model.dynamics, record.sample_time_s)
    times = timeit.repeat(lambda: block.respond(hysteresis.respond(u)[0]), number=1, repeat=REPEATS + 1)
    return 1e9 * min(times[1:]) / TIMED_SAMPLES  # the first one may have to compile
