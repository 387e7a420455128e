"""Identification of a model from records, with its fit report."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from hammerstein.blocks.instruments import Instruments
from hammerstein.errors import IdentificationError, InputError
from hammerstein.identification.excitation import (
    counted,
    refuse_noise,
    refuse_one_way,
    responses,
    voltages_of,
)
from hammerstein.identification.fit import KIND_NAMES, CandidateSet, Fit, FittedModel, Kind, Progress, Task
from hammerstein.identification.fit_report import Prepared, fit_of, model_of
from hammerstein.identification.initialisation import first_task
from hammerstein.identification.kinds import with_hysteresis
from hammerstein.identification.model_selection import Trial, chosen, trial_of
from hammerstein.identification.options import PLAYS, identifiable_kinds
from hammerstein.identification.parameter_covariance import parameter_covariance
from hammerstein.identification.play_candidates import build_axes, build_static
from hammerstein.identification.score import Score, SensorModel, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.state_space_candidates import build_state_space
from hammerstein.identification.static.initial_state import judged_starts
from hammerstein.identification.static.regressors import InitialState
from hammerstein.model import HammersteinModel
from hammerstein.records.gains import refuse_swapped
from hammerstein.records.record import Record, begins_at_rest, dead_start
from hammerstein.runtime.resources import one_blas_thread


@contextmanager
def _told() -> Iterator[None]:
    """Turn equations that cannot be solved, whichever they are, into what a person can do about them."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "the records do not determine the requested model: its equations cannot be solved "
            f"({error}). Use longer records or a simpler model: fewer operators, another "
            "partition, no dynamics"
        ) from None


def identify(
    records: Record | Sequence[Record],
    settings: Settings | None = None,
    *,
    validation: Record | Sequence[Record] = (),
    name: str = "identified",
    instruments: Instruments | None = None,
    progress: Progress | None = None,
) -> tuple[HammersteinModel, Fit]:
    """Identify a model from measured records and report its errors.

    The candidates are a linear gain, a static Prandtl-Ishlinskii block, linear dynamics alone and the
    Hammerstein model, as far as ``settings`` allows. The function returns the model with the fewest
    parameters whose cross-validation error is as good as the best (see ``choice.chosen``). Validation records
    do not affect the choice: they are used once, for their error. The verdict states which blocks improve the
    model, and which effects it cannot represent.

    Parameters
    ----------
    records : experiments on one actuator, with any inputs driven in each
    settings : options; if not given, thresholds, their number and the dynamics are chosen automatically
    validation : validation records: reported, never used to choose
    name : of the model
    instruments : drive and sensor for the model file; ideal ones on the records' sample time if not given
    progress : called with the current step

    Returns
    -------
    model : the actuator's model; its file holds the voltages as recorded and the verdict
    fit : errors, offsets, standard errors, statements

    Raises
    ------
    InputError : records that do not fit together, swapped columns
    IdentificationError : records that do not determine the model

    Examples
    --------
    >>> from hammerstein.hysteresis import (Pair, PrandtlIshlinskii)
    >>> u = 4.0 * np.sin(2.0 * np.pi * np.arange(1200) / 300) * np.linspace(1.0, 0.5, 1200)
    >>> truth = PrandtlIshlinskii([[Pair([0.0, 1.0, 2.0], [3.0, 1.0, 1.0])]])
    >>> record = Record([u], truth.respond([u])[0], 1e-3)
    >>> model, fit = identify([record], Settings(thresholds_v=[0.0, 1.0, 2.0], dynamics="none"))
    >>> model.hysteresis.pairs[0][0].weights_um_per_v.round(6), fit.invertible
    (array([3., 1., 1.]), True)
    """
    asked = Settings() if settings is None else settings
    if not isinstance(asked, Settings):
        raise InputError("settings", f"are a {type(asked).__name__}; give Settings(...)")

    def found(asked: Settings) -> tuple[HammersteinModel, Fit]:
        prepared = fit_plays(records, asked, validation, progress)
        return fit_kind(prepared, asked, name=name, instruments=instruments, progress=progress)

    try:
        return found(asked)
    except UntoldError as error:
        model, fit = found(asked.with_plays())
        return model, replace(fit, not_identifiable=(str(error), *fit.not_identifiable))


class UntoldError(IdentificationError):
    """The records do not identify the parameters of a kind of hysteresis other than those of plays."""


def settings_of_plays(asked: Settings, kind: str) -> Settings:
    """Settings of the play model that is fitted before another kind of hysteresis."""
    settings = asked if kind == PLAYS else asked.without_auto()
    if identifiable_kinds()[kind].passes_for_delay and asked.delay_samples is None:
        # plays alone would take widening loops for a delay
        settings = settings.changed(delay_samples=0)
    return settings.with_plays()


@_told()
@one_blas_thread()
def fit_plays(
    records: Record | Iterable[Record],
    asked: Settings,
    validation: Record | Iterable[Record] = (),
    progress: Progress | None = None,
) -> Prepared:
    """Fit plays and linear models, before any other kind; see ``identify``."""
    settings, tell = settings_of_plays(asked, asked.hysteresis), progress or _silent
    records, validation = given_records(records), given_records(validation)
    ready = from_last_rest(records, settings.sensor, accept_order=settings.accept_order)
    held = (
        from_last_rest(validation, settings.sensor, accept_order=settings.accept_order) if validation else ()
    )
    _refuse_mixed([*ready, *held])
    if not settings.fast and settings.dynamics != "state_space":
        refuse_one_way(ready)
    task, guess, curve = first_task(ready, settings, tell)
    build = build_state_space if task.settings.dynamics == "state_space" else build_static
    built = build_axes(task, guess) if guess else build(task)
    response = responses(built.best.candidate, ready, task.starts)
    refuse_noise(ready, response)
    held_starts = _starts_of_held(held, built, settings)
    tell("testing the models")
    built, trials = _kept(task, built)
    task = replace(task, progress=_silent)
    return Prepared(records, task, built, curve, held, held_starts, response, trials)


@_told()
@one_blas_thread()
def fit_kind(
    prepared: Prepared,
    asked: Settings,
    *,
    name: str,
    instruments: Instruments | None = None,
    progress: Progress | None = None,
) -> tuple[HammersteinModel, Fit]:
    """Fit the requested kind of hysteresis, starting from a play model; see ``identify``.

    Raises UntoldError where plays are as good.
    """
    tell, plain = progress or _silent, asked.hysteresis == PLAYS
    task, built, held, settings = prepared.task, prepared.built, prepared.held, prepared.task.settings
    if not plain:
        task, built = with_hysteresis(replace(task, settings=asked, progress=tell), built)
        if built.untold:
            raise UntoldError(built.untold)
        held_starts = _starts_of_held(held, built, settings)
        prepared = replace(prepared, task=task, built=built, held_starts=held_starts)
    fitted = _scores(built, task.records, task.starts, settings)
    judged = _scores(built, held, prepared.held_starts, settings) if held else {}
    tell("estimating the standard errors")
    best = built.best.candidate
    placed = built.best.blocks.fitted if plain else best.placed
    known = parameter_covariance(best, task.records, task.starts, placed)
    voltages = voltages_of(prepared.given, task.records, task.starts, best)
    fit = fit_of(prepared, fitted, judged, voltages, known)
    return model_of(fit, best, name, instruments), fit


def _silent(_: str) -> None:
    """Nobody watches."""


def _scores(
    built: CandidateSet, records: tuple[Record, ...], starts: tuple[InitialState, ...], settings: Settings
) -> dict[Kind, Score]:
    """Errors of every kind of model on the same samples, each with the past that it explains best."""
    return {
        kind: score(candidate, records, candidate.own_starts(records, starts, settings.start_mode))
        for kind, candidate in built.candidates.items()
    }


def _starts_of_held(
    held: tuple[Record, ...], built: CandidateSet, settings: Settings
) -> tuple[InitialState, ...]:
    """Initial states of the validation records, by the best model or by one that explains the start."""
    best = built.best.candidate
    simpler = [candidate.predict for candidate in built.candidates.values() if candidate is not best]
    return judged_starts(held, best.predict, best.settle_s, settings.start_mode, simpler, best.slow_s)


def _kept(task: Task, built: CandidateSet) -> tuple[CandidateSet, tuple[Trial, ...]]:
    """The model that is as good as the best with the fewest parameters, and all that were tried."""
    named: list[tuple[str, Kind, FittedModel]] = [
        *((KIND_NAMES[kind], kind, found) for kind, found in built.found.items()),
        *((name, "hammerstein", found) for name, found in built.others),
    ]
    records, trials = task.records, []
    for name, _, found in named:
        candidate = found.candidate
        own = candidate.own_starts(records, task.starts, task.settings.start_mode)
        told = not found.axes or any(axis.identified for axis in found.axes)
        inverse = candidate.has_inverse(records)
        trials.append(trial_of(name, candidate, records, own, invertible=inverse, told=told))
    i = chosen(trials)
    _, kind, found = named[i]
    marked = tuple(replace(trial, kept=k == i) for k, trial in enumerate(trials))
    return replace(built, kind=kind, found={**built.found, kind: found}), marked


def given_records(given: Record | Iterable[Record]) -> tuple[Record, ...]:
    """One record or several as a tuple; InputError for anything else."""
    records = (given,) if isinstance(given, Record) else tuple(given)
    if strange := [one for one in records if not isinstance(one, Record)]:
        kind = type(strange[0]).__name__
        raise InputError("records", f"hold a {kind}; give values of Record(u_v, y_um, sample_time_s)")
    return records


def from_last_rest(
    records: Record | Iterable[Record], sensor: SensorModel | None = None, *, accept_order: bool = False
) -> tuple[Record, ...]:
    """Records from their last rest on, with voltages relative to it.

    sensor : whose known delay is taken off the readings, in whole samples; none if not given
    accept_order : whether an output may lead its input
    """
    records = given_records(records)
    if not records:
        raise InputError("records", "there are none")
    _refuse_mixed(records)
    _refuse_twice(records)
    if not accept_order:
        refuse_swapped(records)
    prompt = [(sensor or SensorModel()).prompt(record) for record in records]
    return tuple(counted(_without_dead_start(record)) for record in prompt)


def _without_dead_start(record: Record) -> Record:
    """The record without its initial rest: constant voltages and readings carry no information."""
    return record.part(dead_start(record), record.samples) if begins_at_rest(record) else record


def _refuse_mixed(records: Sequence[Record]) -> None:
    shapes = {(len(record.u_v), len(record.y_um)) for record in records}
    if len(shapes) > 1:
        listed = ", ".join(f"{m} inputs and {p} outputs" for m, p in sorted(shapes))
        raise InputError("records", f"have different axes: {listed}")


def _refuse_twice(records: Sequence[Record]) -> None:
    """Refuse a record that is given twice, by whatever name: it would count double and pass for sure."""
    for i, record in enumerate(records):
        for other in records[:i]:
            alike = map(np.array_equal, (record.u_v, record.y_um), (other.u_v, other.y_um))
            if record.sample_time_s == other.sample_time_s and all(alike):
                named = record.source == other.source
                what = "is given twice" if named else f"is the same record as {other.source}"
                raise InputError(record.source, f"{what}: give every record once")
