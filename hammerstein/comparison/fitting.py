"""Models of every kind from the same records, with their identification time."""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from hammerstein.blocks.voltages import Verdict
from hammerstein.dynamics import AxesDynamics
from hammerstein.errors import HammersteinError
from hammerstein.identification.excitation import several_rates
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.fit_report import Prepared
from hammerstein.identification.identify import fit_kind, fit_plays, identify, settings_of_plays
from hammerstein.identification.options import PLAYS, identifiable_kinds
from hammerstein.identification.residual_analysis import stated_errors
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.parallel_tasks import Jobs, Processes, in_order

Progress = Callable[[str, int, int], None]
"""Told what is being done, how many identifications are done, and of how many."""

WARM_SAMPLES = 400
"""Of the record that compiles the loops before the fits are timed; few, as only the kind of call counts."""
LINEAR = "none"
WITH_DYNAMICS = " with dynamics"
OF_PLAYS: Mapping[Kind, tuple[str, str]] = {
    "linear": ("linear gain", LINEAR),
    "linear_dynamics": ("linear dynamics", LINEAR),
    "static_hysteresis": (PLAYS, PLAYS),
    "hammerstein": (PLAYS + WITH_DYNAMICS, PLAYS),
}
"""Models that one identification with plays gives: what they are called, and their kind of hysteresis."""


@dataclass(frozen=True, eq=False)
class Fitted:
    """One model as ``identify`` gave it.

    Parameters
    ----------
    name : name in tables
    hysteresis : its kind, ``none`` for a linear model
    model, candidate : the model, and its form that predicts records
    starts, held_starts : initial states of the records, from that identification
    flags : effects that it cannot represent
    seconds : processor time of its identification with that of the plays before it [s]
    """

    name: str
    hysteresis: str
    model: HammersteinModel
    candidate: Candidate
    starts: tuple[InitialState, ...]
    held_starts: tuple[InitialState, ...]
    flags: tuple[str, ...]
    seconds: float


@dataclass(frozen=True)
class Failed:
    """A kind that could not be fitted, and why."""

    name: str
    hysteresis: str
    reason: str


@dataclass(frozen=True, eq=False)
class _Given:
    """What was fitted: models, or the error that ended it, and plays where they were fitted on the way."""

    models: tuple[Fitted, ...] = ()
    error: HammersteinError | None = None
    prepared: Prepared | None = None
    seconds: float = 0.0


def fit_all(
    records: Sequence[Record],
    settings: Settings,
    validation: Sequence[Record],
    jobs: Jobs,
    progress: Progress,
) -> tuple[list[Fitted], list[Failed]]:
    """Identify every kind of hysteresis without a linear block, and with the linear block that suits it.

    ``identify`` finds that block with the kind itself; for records at a single rate, it is the one found with
    plays. Plays with the same settings are fitted once for all kinds.

    Parameters
    ----------
    records, settings, validation : as for ``identify``; the kind of hysteresis in the settings is not used
    jobs : number of parallel identifications, or an executor for them
    progress : see ``Progress``

    Raises
    ------
    HammersteinError : of the identification with plays, where no kind can be fitted
    """
    others = [kind for kind in identifiable_kinds() if kind != PLAYS]
    settings = settings.with_plays()
    known: dict[Settings, _Given] = {}

    given = partial(_worked_off, jobs=jobs, progress=progress, total=1 + len(others))

    def fitted(kinds: Sequence[str], asked: Settings, done: int) -> list[_Given]:
        """Fit kinds behind plays of their settings, those that are not known first."""
        wanted = [settings_of_plays(asked, kind) for kind in kinds]
        new = [one for one in dict.fromkeys(wanted) if one not in known]
        tasks = [partial(_of_plays, tuple(records), tuple(validation), one) for one in new]
        known.update(zip(new, given(tasks, [PLAYS] * len(new), done), strict=True))
        each = zip(wanted, kinds, strict=True)
        return given([partial(_of_kind, known[plays], asked, kind) for plays, kind in each], kinds, done)

    [plays] = fitted([PLAYS], settings, 0)
    behind = _with_dynamics(records, settings, plays) or _without_dynamics(settings)
    found = {PLAYS: plays, **dict(zip(others, fitted(others, behind, 1), strict=True))}
    models = [model for one in found.values() for model in one.models]
    if not models and plays.error is not None:
        raise plays.error
    failed = [
        Failed(kind + WITH_DYNAMICS * bool(one.models), kind, str(one.error))
        for kind, one in found.items()
        if one.error
    ]
    return models, failed


def _with_dynamics(records: Sequence[Record], settings: Settings, plays: _Given) -> Settings | None:
    """Settings with which other kinds have a linear block; None where there is none."""
    if settings.dynamics == "none":
        return None
    if settings.dynamics != "auto" or several_rates(records):
        return settings
    found = {model.name: model for model in plays.models}.get(PLAYS + WITH_DYNAMICS)
    if found is None or not isinstance(found.candidate.dynamics, AxesDynamics):
        return None
    axes = found.candidate.dynamics.axes
    resonant = any(axis.resonance_hz is not None for axis in axes)
    modes = max(len(axis.creep) for axis in axes) if settings.creep_modes == "auto" else settings.creep_modes
    return settings.changed(dynamics="second_order" if resonant else "lag", creep_modes=modes)


def _without_dynamics(settings: Settings) -> Settings:
    return settings.changed(dynamics="none", order=None, creep_modes=0)


def _worked_off(
    tasks: Sequence[Callable[[], _Given]],
    names: Sequence[str],
    done: int,
    *,
    jobs: Jobs,
    progress: Progress,
    total: int,
) -> list[_Given]:
    """Results in the order of the tasks, some computed in parallel."""
    waiting = list(names)

    def finished(number: int, _: object = None) -> None:
        waiting.remove(names[number])
        tell()

    def tell() -> None:
        if waiting:
            progress(f"fitting {', '.join(dict.fromkeys(waiting))}", done + len(names) - len(waiting), total)

    tell()
    with _crew(jobs, len(tasks)) as crew:
        return list(in_order(tasks, crew, finished))


def _crew(jobs: Jobs, tasks: int) -> AbstractContextManager[Jobs]:
    """Processes of this machine, which do not share their time, or the executor that is given."""
    if isinstance(jobs, int) and jobs > 1 and tasks > 1:
        return Processes(min(jobs, tasks))
    return nullcontext(jobs)


def _of_plays(records: tuple[Record, ...], validation: tuple[Record, ...], asked: Settings) -> _Given:
    """Plays, behind which kinds are fitted; an error that a user can correct is a result, too."""
    _use_once(PLAYS)
    begun = time.process_time()
    try:
        prepared = fit_plays(records, asked, validation)
    except HammersteinError as error:
        return _Given(error=error)
    return _Given(prepared=prepared, seconds=time.process_time() - begun)


def _of_kind(plays: _Given, asked: Settings, kind: str) -> _Given:
    """One kind, with and without dynamics, behind plays that were fitted."""
    if plays.prepared is None:
        return plays
    _use_once(kind)
    begun = time.process_time()
    try:
        model, fit = fit_kind(plays.prepared, asked.changed(hysteresis=kind), name=kind)
    except HammersteinError as error:
        if asked.dynamics == "none":
            return _Given(error=error)
        return replace(_of_kind(plays, _without_dynamics(asked), kind), error=error)
    seconds = plays.seconds + time.process_time() - begun
    if kind == PLAYS:
        known = ((OF_PLAYS[which], one) for which, one in fit.candidates.items())
        return _Given(tuple(_fitted(fit, one, model, *names, seconds) for names, one in known))
    best = fit.candidates[fit.kind]
    found = {kind: best} if fit.is_static else {kind: fit.alone or best, kind + WITH_DYNAMICS: best}
    return _Given(tuple(_fitted(fit, one, model, name, kind, seconds) for name, one in found.items()))


@cache
def _use_once(kind: str) -> None:
    """Load and compile the code of a kind, so that this does not count as identification time."""
    turn = np.linspace(0.0, 6.0, WARM_SAMPLES) ** 2
    u = np.sin(turn) * np.linspace(1.0, 0.6, WARM_SAMPLES)
    record = Record(u[None], (u + np.sin(turn - 0.2))[None], 1e-3)
    settings = Settings(operators=3, dynamics="lag", creep_modes=0, error_curve=False, hysteresis=kind)
    with contextlib.suppress(HammersteinError):
        identify([record], settings)


def _fitted(
    fit: Fit, candidate: Candidate, model: HammersteinModel, name: str, hysteresis: str, seconds: float
) -> Fitted:
    best = candidate is fit.candidates[fit.kind]
    if not best:  # counts from any working point
        judged, starts = (fit.held, fit.held_starts) if fit.held else (fit.records, fit.starts)
        told = stated_errors(score(candidate, judged, candidate.own_starts(judged, starts)), judged)
        model = replace(
            model,
            hysteresis=candidate.hysteresis,
            dynamics=candidate.dynamics,
            verdict=Verdict(flagged=False, held_out=bool(fit.held), **told),
            covariance=None,
        )
    model, flags = replace(model, name=name), fit.flags if best else ()
    return Fitted(name, hysteresis, model, candidate, fit.starts, fit.held_starts, flags, seconds)
