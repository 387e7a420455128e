"""Models of every kind from the same records, with their identification time."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from hammerstein.dynamics import AxesDynamics, StaticDynamics
from hammerstein.errors import HammersteinError, IdentificationError
from hammerstein.identification.fit import Fit, Kind
from hammerstein.identification.identify import identify
from hammerstein.identification.options import PLAYS, identifiable_kinds
from hammerstein.identification.rates import several_rates
from hammerstein.identification.score import Candidate
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record
from hammerstein.runtime.parallel_tasks import Jobs, in_order
from hammerstein.runtime.workers import Processes

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
    seconds : processor time of its identification [s]; plays and linear models come from the same one
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
class _Asked:
    """One identification: what its model is called, its kind of hysteresis, the settings beside that."""

    name: str
    hysteresis: str
    settings: Settings


@dataclass(frozen=True, eq=False)
class _Given:
    """What one identification gave: models, or the error that ended it."""

    asked: _Asked
    models: tuple[Fitted, ...] = ()
    error: HammersteinError | None = None


def fit_all(
    records: Sequence[Record],
    settings: Settings,
    validation: Sequence[Record],
    jobs: Jobs,
    progress: Progress,
) -> tuple[list[Fitted], list[Failed]]:
    """Identify every kind of hysteresis without a linear block, and with the linear block that suits it.

    ``identify`` finds that block with the kind itself; for records at a single rate, it is the one found with
    plays.

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
    static = replace(settings, dynamics="none", order=None, creep_modes=0)
    first = [_Asked(PLAYS, PLAYS, settings), *(_Asked(kind, kind, static) for kind in others)]
    total = len(first) + len(others) * (settings.dynamics != "none")

    def tell(what: str, done: int) -> None:
        progress(what, done, total)

    given = _worked_off(records, validation, first, jobs, tell)
    linear = _with_dynamics(records, settings, given[0])
    if linear is not None:
        second = [_Asked(kind + WITH_DYNAMICS, kind, linear) for kind in others]
        given += _worked_off(records, validation, second, jobs, tell, len(first))
    fitted = [model for one in given for model in one.models]
    if not fitted and given[0].error is not None:
        raise given[0].error
    return fitted, [
        Failed(one.asked.name, one.asked.hysteresis, str(one.error)) for one in given if one.error
    ]


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
    return replace(settings, dynamics="second_order" if resonant else "lag", creep_modes=modes)


def _worked_off(
    records: Sequence[Record],
    validation: Sequence[Record],
    asked: Sequence[_Asked],
    jobs: Jobs,
    progress: Callable[[str, int], None],
    before: int = 0,
) -> list[_Given]:
    """Results in the order of the requests, some computed in parallel."""
    tasks = [partial(_identified, tuple(records), tuple(validation), one) for one in asked]
    waiting = [one.name for one in asked]

    def finished(number: int, _: object = None) -> None:
        waiting.remove(asked[number].name)
        tell()

    def tell() -> None:
        if waiting:
            progress(f"fitting {', '.join(waiting)}", before + len(asked) - len(waiting))

    tell()
    with _crew(jobs, len(tasks)) as crew:
        return list(in_order(tasks, crew, finished))


def _crew(jobs: Jobs, tasks: int) -> AbstractContextManager[Jobs]:
    """Processes of this machine, which do not share their time, or the executor that is given."""
    if isinstance(jobs, int) and jobs > 1 and tasks > 1:
        return Processes(min(jobs, tasks))
    return nullcontext(jobs)


def _identified(records: tuple[Record, ...], validation: tuple[Record, ...], asked: _Asked) -> _Given:
    """One identification; its result may be an error that a user can correct, other errors are raised."""
    _use_once(asked.hysteresis)
    begun = time.process_time()
    try:
        settings = replace(asked.settings, hysteresis=asked.hysteresis)
        model, fit = identify(records, settings, validation=validation, name=asked.name)
    except HammersteinError as error:
        return _Given(asked, error=error)
    seconds = time.process_time() - begun
    if asked.hysteresis == PLAYS:
        models = (
            _fitted(fit, kind, replace(model, name=name), name, hysteresis, seconds)
            for kind, (name, hysteresis) in OF_PLAYS.items()
            if kind in fit.candidates
        )
        return _Given(asked, tuple(models))
    if model.hysteresis.kind != asked.hysteresis:
        return _Given(asked, error=IdentificationError(f"not identifiable: {fit.not_identifiable[0]}"))
    dynamic = not isinstance(model.dynamics, StaticDynamics)
    if asked.name.endswith(WITH_DYNAMICS) and not dynamic:
        return _Given(asked)  # the same as the kind alone
    return _Given(asked, (_fitted(fit, fit.kind, model, asked.name, asked.hysteresis, seconds),))


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
    fit: Fit, kind: Kind, model: HammersteinModel, name: str, hysteresis: str, seconds: float
) -> Fitted:
    candidate = fit.candidates[kind]
    if kind != fit.kind:  # of plays, which count from any working point
        model = replace(
            model,
            hysteresis=candidate.hysteresis,
            dynamics=candidate.dynamics,
            verdict=None,
            covariance=None,
        )
    flags = fit.flags if kind == fit.kind else ()
    return Fitted(name, hysteresis, model, candidate, fit.starts, fit.held_starts, flags, seconds)
