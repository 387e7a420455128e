"""Other kinds of hysteresis that replace the classical block of a model, fitted to the same records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from hammerstein.dynamics import AxesDynamics, StaticDynamics
from hammerstein.hysteresis import Hysteresis, PrandtlIshlinskii
from hammerstein.hysteresis.identifiable import Identifiable
from hammerstein.identification.columns import NEAR, chosen_columns, driven_of, error_left_out, few_places
from hammerstein.identification.excitation import several_rates
from hammerstein.identification.fit import CandidateSet, FittedModel, Kind, Task, thresholds_of
from hammerstein.identification.initialisation import creeping_starts
from hammerstein.identification.linear.axis_task import parameters_of as axis_parameters
from hammerstein.identification.model_selection import Trial, chosen, enough_readings, lowers, trial_of
from hammerstein.identification.options import identifiable_kinds
from hammerstein.identification.output_dynamics import (
    OutputDynamics,
    search_output_dynamics,
    sure_output_dynamics,
)
from hammerstein.identification.play_candidates import WORTHWHILE, begun_static
from hammerstein.identification.projection import ENOUGH, ROUGHLY, fit_block
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.search import MOST_DELAY, WORSE_DELAYS, alike_clocks
from hammerstein.identification.static.initial_state import (
    FEWEST,
    Predict,
    alike_starts,
    closed,
    each_alone,
    judged_starts,
    split_state,
    unexplained,
)
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import Thresholds
from hammerstein.identification.static.threshold_search import price

WITHOUT_PLAYS = ("linear", "linear_dynamics")
MOST_TURNS = 4
"""Largest number of alternating fits of block and axes; each must lower the error by half a percent."""
DELAY_TURN = 1
"""Turn that estimates the delay, behind a block fitted in front of axes."""
BEGINNING = 20_000
"""Samples of all records together for the initial states."""


@dataclass(frozen=True, eq=False)
class FittedBlock:
    """Fitted block of another kind, notes on it, and the ridge of its weights.

    ``picked``: its columns were chosen among many. ``placed``: its places were fitted.
    ``rough``: only its weights need to be found again.
    ``at_limit``: a parameter ended at the limit of what the records determine.
    """

    hysteresis: Hysteresis[Any]
    notes: tuple[str, ...] = ()
    ridge: float = 0.0
    picked: bool = False
    placed: bool = False
    rough: bool = False
    at_limit: bool = False


def with_hysteresis(task: Task, built: CandidateSet) -> tuple[Task, CandidateSet]:
    """The models, with one of the requested kind of hysteresis; ``classical`` keeps plays.

    Lag, resonance and creep are found again behind the block itself, because plays would leave errors that
    look like them. With dynamics ``auto`` this needs records at several rates: at a single rate, a lag looks
    like hysteresis. So does a delay: without dynamics every delay is tried, and no delay is always among
    them.

    Parameters
    ----------
    task : records and settings; plays gave its thresholds, delay and initial states
    built : the models with plays

    Returns
    -------
    task : with the initial states and the delay of the chosen model
    built : the models with that one
    """
    settings, kind, with_plays = task.settings, task.settings.hysteresis, task.delay_samples
    task.progress(f"fitting the {kind.replace('_', ' ')} hysteresis")
    before, given_v = built.best, task.thresholds_v
    task = task.delayed_as(before.candidate.dynamics)
    task = replace(task, thresholds_v=_thresholds_of_plays(built))
    tried = [_without_axes(task, free=_free_delay(task))]
    asked = settings.dynamics != "auto" or settings.creep_modes not in (0, "auto")
    if settings.dynamics != "none" and (asked or several_rates(task.records)):
        tried.append(_with_axes(task, tried[0].block))
    found = tried[chosen(trials_of(task, tried))]
    task = replace(task, starts=found.starts, delay_samples=found.behind.delay_samples)
    name: Kind = "static_hysteresis" if found.behind.is_static else "hammerstein"
    axes = () if found.behind.is_static else found.behind.fits
    alike = before if found.behind.is_static else _plays_before(task, found.behind, before)
    plays = {**built.found, "classical": alike}
    if name == built.kind == "static_hysteresis" and task.delay_samples != with_plays:
        begun = replace(task, thresholds_v=given_v)  # with the delay of a model without plays
        alone = begun_static(begun).found
        plays = _better(task, plays, {"linear": alone["linear"], "classical": alone["static_hysteresis"]})
    models = {**plays, name: FittedModel(found.candidate, before.blocks, axes)}
    notes, untold = (*built.notes, *found.block.notes), _untold(task, found)
    built = replace(built, found=models, kind=name, axes=axes, notes=notes, untold=untold)
    return task, replace(built, alone=tried[0].candidate)


def _plays_before(task: Task, behind: OutputDynamics, static: FittedModel) -> FittedModel:
    """Plays before the axes that were found behind the other kind: what that kind is compared with."""
    task = replace(task, settings=task.settings.with_plays())
    plays = PrandtlIshlinskii.first_guesses(driven_of(task, task.thresholds_v))[0]
    whole = _before(task, behind, FittedBlock(plays, rough=True))
    return FittedModel(whole.candidate, static.blocks, behind.fits)


def _thresholds_of_plays(built: CandidateSet) -> Thresholds:
    """Thresholds of the best model with plays, as another kind needs them.

    Where linear dynamics alone were kept, plays can still be what that kind is made of.
    """
    kinds: tuple[Kind, ...] = (built.kind, "hammerstein", "static_hysteresis")
    with_plays = (built.found[k] for k in kinds if k in built.found and k not in WITHOUT_PLAYS)
    return thresholds_of(next(with_plays, built.best).blocks)


def _untold(task: Task, found: HammersteinFit) -> str:
    """Parameters of a kind that the records do not identify: without them, plays are as good."""
    block = found.block.hysteresis
    own = block.without_own() if isinstance(block, Identifiable) else None
    if own is None:
        return ""
    without, words = own
    like = FittedBlock(cast("Hysteresis[Any]", without), rough=True)
    plain = _before(task, found.behind, like)
    with_own, alone = (replace(t, usable=True) for t in trials_of(task, [found, plain]))
    if chosen([replace(alone, parameters=0), with_own]):
        return ""
    return (
        f"{words}: the cross-validation error of plays alone is {alone.percent:.3g} % of the range, "
        f"that of {task.settings.hysteresis} {with_own.percent:.3g} %; the model keeps plays"
    )


def _better(
    task: Task, found: dict[Kind, FittedModel], others: dict[Kind, FittedModel]
) -> dict[Kind, FittedModel]:
    """For each kind of model, the one of two with the smaller error on the records."""

    def left(one: FittedModel) -> float:
        return score(one.candidate, task.records, task.starts).mean_percent

    return {kind: min([one, others.get(kind, one)], key=left) for kind, one in found.items()}


def _without_axes(task: Task, free: bool) -> HammersteinFit:
    """Block without dynamics: with the delay known, or the shortest that is as good as any.

    What went before the records was judged with plays. It is judged anew with the block itself once the delay
    is known, for a delay looks like another beginning.
    """
    delays = range(MOST_DELAY + 1) if free else (task.delay_samples,)
    found: list[HammersteinFit] = []
    left: list[float] = []
    for turn, delay in enumerate(delays):
        like = replace(found[-1].block, rough=found[-1].block.picked) if found else None
        found.append(_before(task, OutputDynamics((), delay), like, ROUGHLY))
        left.append(score(found[-1].candidate, task.records, task.starts).mean_percent)
        if turn - int(np.argmin(left)) >= WORSE_DELAYS:  # two more leave more
            break
    nearest = _first_as_good(task, found)
    like = nearest.block if nearest is found[0] else _again(nearest.block)  # whose columns are its own
    nearest = _with_few_places(task, _before(task, nearest.behind, like))
    begun = _begun_anew(task, nearest, first=False)
    return nearest if begun is nearest else _first_as_good(task, [nearest, begun])


def _first_as_good(task: Task, found: Sequence[HammersteinFit]) -> HammersteinFit:
    """The first of several models that no other one is beyond doubt better than."""
    return found[chosen([replace(t, parameters=i) for i, t in enumerate(trials_of(task, found))])]


def _free_delay(task: Task) -> bool:
    """Whether the delay is to be found: thresholds that grow with the rate look like one."""
    told = not all(closed(record) for record in task.records)  # a single loop looks late
    kind = identifiable_kinds()[task.settings.hysteresis]
    free = task.settings.delay_samples is None and not kind.passes_for_delay
    return free and told and alike_clocks(task.records)


def trials_of(task: Task, tried: Sequence[HammersteinFit]) -> list[Trial]:
    """Cross-validation errors of each model on the fitted records.

    All are judged on the same samples: a beginning that one of them explains counts for all.
    """
    found = []
    for one in tried:
        starts, inverse = _judged_alike(task, one, tried), one.candidate.has_inverse(task.records)
        found.append(trial_of(one.name, one.candidate, task.records, starts, invertible=inverse))
    return found


def _judged_alike(
    task: Task, one: HammersteinFit, tried: Sequence[HammersteinFit]
) -> tuple[InitialState, ...]:
    """Initial states for judging one of several models; those of its fit where they explain the record."""
    simpler = [other.candidate.predict for other in tried if other is not one]
    settle_s = max(other.candidate.settle_s for other in tried)
    open_ = unexplained(task.records, one.starts)
    judged = judged_starts(
        [task.records[i] for i in open_],
        one.candidate.predict,
        settle_s,
        task.settings.start,
        simpler,
        one.candidate.slow_s,
    )
    again = dict(zip(open_, judged, strict=True))
    return tuple(again.get(i, start) for i, start in enumerate(one.starts))


class HammersteinFit(NamedTuple):
    """Hysteresis block and the linear dynamics behind it."""

    candidate: Candidate
    behind: OutputDynamics
    block: FittedBlock
    starts: tuple[InitialState, ...]

    @property
    def name(self) -> str:
        """Name for a table."""
        shapes = dict.fromkeys(axis_parameters(axis)[0].name for axis in self.behind.axes)
        return ", ".join(shapes) or f"{self.behind.delay_samples:g} samples late"


def _with_axes(task: Task, alone: FittedBlock, sure_of_starts: bool = False) -> HammersteinFit:
    """Block, axes and initial states, fitted in turn until the error falls no further.

    The block is fitted with its bounds and all its nonlinear parameters, the axes together with its weights.
    Columns are chosen in every turn: in front of axes that have not converged, too few columns would seem
    sufficient. Once there are axes, the block starts again from its first guess, because without axes it had
    adapted to their effect.

    alone : the block found without axes
    sure_of_starts : whether the initial states of the task stay
    """
    free, least = _free_delay(task), math.inf
    found = OutputDynamics((), float(task.settings.delay_samples or 0))
    whole = _before(task, found, None if alone.placed else alone, ROUGHLY)
    for turn in range(MOST_TURNS):
        found = search_output_dynamics(task, whole.block.hysteresis, found, free and turn == DELAY_TURN)
        like, enough = (_again(whole.block), ENOUGH) if turn else (None, ROUGHLY)
        task.progress(f"fitting hysteresis and dynamics together, round {turn + 1} of at most {MOST_TURNS}")
        whole = _before(task, found, like, enough)
        found = whole.behind
        begun = whole if sure_of_starts else _begun_anew(task, whole, first=turn == 0)
        moved = begun is not whole
        whole, found, task = begun, begun.behind, replace(task, starts=begun.starts)
        error = score(whole.candidate, task.records, task.starts).mean_percent
        if not (moved or lowers(error, least, WORTHWHILE)):
            break
        least = error
    one = whole if sure_of_starts else _of_one_state(task, whole)
    if one is not whole:  # what was found with the other states is no good beginning
        return _with_axes(replace(task, starts=one.starts), alone, sure_of_starts=True)
    whole = _with_few_places(task, whole)
    sure = sure_output_dynamics(task, whole.block.hysteresis, whole.behind)
    return _before(task, sure, replace(whole.block, rough=True))._replace(behind=sure)


def _of_one_state(task: Task, whole: HammersteinFit) -> HammersteinFit:
    """The same model, or one for which records that begin at one voltage and position begin in one state.

    Plays told the states first. A kind and its creep that were fitted with wrong ones confirm them.
    """
    if task.settings.start != "auto" or not split_state(task.records, whole.starts):
        return whole
    task.progress("fitting with one initial state of all records")
    ways = alike_starts(task.records)
    others = [
        _before(replace(task, starts=ways[kind]), whole.behind, whole.block)
        for kind in ("rest", "low", "high")
    ]
    return min([whole, *others], key=lambda one: score(one.candidate, task.records, one.starts).mean_percent)


def _with_few_places(task: Task, whole: HammersteinFit) -> HammersteinFit:
    """The same model, or one with few places that are fitted if it leaves less on the folds.

    Places are fitted to the folds too, so each must save its price there; where readings are too few for all
    the columns, it need only leave as little. In front of axes that have not converged, too few columns would
    seem sufficient.
    """
    task = replace(task, delay_samples=whole.behind.delay_samples)
    driven, kind = driven_of(task, task.thresholds_v), identifiable_kinds()[task.settings.hysteresis]
    if not whole.block.picked or not (begins := kind.spread(driven)):
        return whole
    few = few_places(task, begins, driven, whole.behind)
    ridge = whole.block.ridge
    many = error_left_out(task, whole.block.hysteresis, whole.candidate.dynamics, ridge)
    left = error_left_out(task, few.hysteresis, _dynamics(task, few.behind), ridge)
    most = (1.0 + NEAR) * many
    if enough_readings(whole.candidate, task.records):
        most = many * math.exp(-0.5 * price(len(few.block.released(driven).free), task.readings))
    if few.held or left > most:
        return whole
    return _before(task, few.behind, FittedBlock(few.hysteresis, ridge=ridge, placed=True))


def _again(block: FittedBlock) -> FittedBlock | None:
    """Block from which the search continues; none if its columns are chosen again."""
    return None if block.picked else block


def _begun_anew(task: Task, whole: HammersteinFit, first: bool) -> HammersteinFit:
    """The same model, or the one fitted anew where the records began otherwise for it."""
    starts = _starts_behind(task, whole, first)
    if starts == task.starts:
        return whole
    return _before(replace(task, starts=starts), whole.behind, whole.block)


def _starts_behind(task: Task, whole: HammersteinFit, first: bool) -> tuple[InitialState, ...]:
    """Initial states that suit a model with axes.

    With lag and creep known, states that were undetermined before are estimated again. A slow mode fitted
    with a wrong initial state makes the true one look wrong, so the weights are refitted for each. Creep
    already under way at the start of a record is considered for the first time here.
    """
    mode = task.settings.start
    candidate = whole.candidate
    judged = judged_starts(task.records, candidate.predict, candidate.settle_s, mode, slow_s=candidate.slow_s)
    creeps = candidate.slow_s > 0.0  # one that does not cannot tell whether the actuator did
    starts = tuple(
        new if creeps or not old.held else old for old, new in zip(task.starts, judged, strict=True)
    )
    if first and mode == "auto" and not any(start.held for start in starts):
        fast = tuple(axis.model_copy(update={"creep": ()}) for axis in whole.behind.axes)
        guess = OutputDynamics(fast, whole.behind.delay_samples)
        starts = creeping_starts(task.records, starts, guess, task.settings, task.progress)
    if mode != "auto":
        return starts
    most = max(BEGINNING // len(task.records), FEWEST)
    parts = tuple(record.part(0, min(record.samples, most)) for record in task.records)
    quick, rough = replace(task, records=parts), replace(whole.block, rough=True)

    def fit(starts: Sequence[InitialState]) -> Predict:
        begun = replace(quick, starts=tuple(starts))
        return _before(begun, whole.behind, rough).candidate.predict

    return each_alone(quick.records, starts, fit, unexplained(task.records, starts))


def _before(
    task: Task,
    found: OutputDynamics,
    like: FittedBlock | None = None,
    enough: float = ENOUGH,
) -> HammersteinFit:
    """Block before the axes found, with the columns of another one if it is given."""
    late = replace(task, delay_samples=found.delay_samples)
    block, found = _of_kind(late, found, like, enough)
    candidate = replace(
        late.candidate(block.hysteresis, _dynamics(late, found)), at_limit=block.at_limit, placed=block.placed
    )
    return HammersteinFit(candidate, found, block, task.starts)


def _dynamics(task: Task, found: OutputDynamics) -> AxesDynamics | StaticDynamics:
    return StaticDynamics(n_outputs=task.outputs) if found.is_static else found.dynamics


def _of_kind(
    task: Task, found: OutputDynamics, like: FittedBlock | None, enough: float
) -> tuple[FittedBlock, OutputDynamics]:
    """A block of any kind by the one fit: behind it the axes are fitted along with its free numbers.

    Where the kind has columns to choose from, folds of the records do, and then only the weights are found.
    ``like`` is where the search begins; where that is rough, only the weights are found again.
    """
    driven = driven_of(task, task.thresholds_v)
    kind = identifiable_kinds()[task.settings.hysteresis]
    known = like if like is not None and isinstance(like.hysteresis, kind) else None
    begins = kind.first_guesses(driven) if known is None else [cast(Identifiable, known.hysteresis)]
    picked = known.picked if known else bool(begins[0].column_choices(driven))
    ridge = known.ridge if known else task.settings.ridge
    if picked and known is None:
        task.progress("trying numbers of operators")
        block, ridge = chosen_columns(task, begins, driven, _dynamics(task, found), ridge)
        begins = [block]
    placed = known is not None and known.placed
    begins = [block.released(driven) for block in begins] if placed else begins
    refined = not picked and (like is None or not like.rough)
    fit = fit_block(task, begins, driven, found, refined=refined, ridge=ridge, enough=enough)
    fit = fit._replace(hysteresis=cast("Hysteresis[Any]", fit.block.settled()))
    record = task.records[0]
    notes = [
        *fit.block.statements(record.inputs, record.outputs),
        *(
            f"slopes from {record.inputs[k]} to {record.outputs[o]} held at their lower bound so that the "
            "model stays invertible"
            for o, k in fit.held
        ),
    ]
    if kind.passes_for_delay:
        late = f"used a known delay of {task.delay_samples:g} samples"
        notes.append(f"{late}: a delay and growing thresholds look alike")
    if fit.at_limit:
        count = len(fit.at_limit)
        notes.append(f"parameters of the hysteresis at a limit, which the records do not determine: {count}")
    at_limit = bool(fit.at_limit)
    return FittedBlock(fit.hysteresis, tuple(notes), ridge, picked, placed, at_limit=at_limit), fit.behind
