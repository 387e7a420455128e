"""Every kind of hysteresis and the linear models on the same records: which one to take."""

import timeit
from collections.abc import Sequence
from dataclasses import replace
from pathlib import PurePath

import numpy as np

from hammerstein.comparison.fitting import Failed, Fitted, Progress, fit_all
from hammerstein.comparison.in_loop import NAME as IN_LOOP, LoopFit, fit_in_loop
from hammerstein.comparison.inverting import Inverse, inverse_of, left_by
from hammerstein.comparison.result import Compared, Comparison
from hammerstein.dynamics import on_grid
from hammerstein.identification.identify import from_last_rest
from hammerstein.identification.in_loop.identify import LoopSettings
from hammerstein.identification.initialisation import start_mode
from hammerstein.identification.model_selection import Trial, as_good, chosen, least, trial_of
from hammerstein.identification.residual_analysis import record_flags
from hammerstein.identification.score import Score, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import own_starts
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.resources import one_blas_thread

ALIKE = 1.1
"""Ratio up to which the frequencies of two records count as one."""


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
    own = [main_hz(record) for record in records]
    groups: list[list[float]] = []
    for hz in sorted(own):
        if groups and hz <= ALIKE * groups[-1][0]:
            groups[-1].append(hz)
        else:
            groups.append([hz])
    return [next(float(f"{np.mean(group):.3g}") for group in groups if hz in group) for hz in own]


def main_hz(record: Record) -> float:
    """Median frequency of the power of the voltages [Hz]; for a sine, its frequency.

    Examples
    --------
    >>> time_s = 1e-3 * np.arange(1000)
    >>> u = (1.0 + time_s) * np.sin(2.0 * np.pi * 5.0 * time_s)
    >>> main_hz(Record([u], [u], 1e-3))
    5.0
    """
    about = record.u_v - record.u_v.mean(axis=1, keepdims=True)
    power = np.cumsum((np.abs(np.fft.rfft(about, axis=1)) ** 2).sum(axis=0))
    if power[-1] == 0.0:
        return 0.0
    lines = np.fft.rfftfreq(record.samples, record.sample_time_s)
    return float(lines[np.searchsorted(power, 0.5 * power[-1])])


def scores_at(one: Fitted, records: Sequence[Record], starts: Sequence[InitialState]) -> dict[float, Score]:
    """Errors of a model on the records of each frequency, lowest first."""
    own = frequencies(records)
    pairs = list(zip(records, starts, strict=True))
    found = {}
    for hz in sorted(set(own)):
        there = [pair for pair, f in zip(pairs, own, strict=True) if f == hz]
        found[hz] = score(one.candidate, *zip(*there, strict=True))
    return found


def alike(starts: Sequence[Sequence[InitialState]]) -> list[list[InitialState]]:
    """Starts (model) (record) of several models, from the samples on that count for every one of them."""
    first = [max(begun.first for begun in each) for each in zip(*starts, strict=True)]
    return [[replace(start, first=k) for start, k in zip(own, first, strict=True)] for own in starts]


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
    in_loop : also try hysteresis in the loop of a state space, as ``identify_in_loop`` does; it takes minutes
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
        replace(in_loop, sensor=settings.sensor, accept_order=settings.accept_order),
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
    entries = [
        _entry(one, inverse, trial, one.name in good, best, (ready, held))
        for one, inverse, trial in zip(fitted, inverses, trials, strict=True)
    ]
    if isinstance(loop, LoopFit):
        entries.append(_entry(loop.fitted, loop.inverse, loop.trial, IN_LOOP in good, best, loop.records))
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
    return [
        own_starts(records, begun, one.candidate.predict, start_mode(settings), one.candidate.slow_s)
        for begun, one in zip(alike(starts), fitted, strict=True)
    ]


def _entry(
    one: Fitted,
    inverse: Inverse,
    trial: Trial,
    good: bool,
    best: Fitted,
    records: tuple[tuple[Record, ...], tuple[Record, ...]],
) -> Compared:
    """All results of one model."""
    ready, held = records
    missed = record_flags(one.candidate, [*ready, *held], [*one.starts, *one.held_starts])
    return Compared(
        name=one.name,
        hysteresis=one.hysteresis,
        dynamics=one.model.dynamics.describe(),
        parameters=trial.parameters,
        fitted=score(one.candidate, ready, one.starts),
        held=score(one.candidate, held, one.held_starts) if held else None,
        fitted_at=scores_at(one, ready, one.starts),
        held_at=scores_at(one, held, one.held_starts),
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
