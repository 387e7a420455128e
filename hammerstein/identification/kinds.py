"""Other kinds of hysteresis in place of the classical block of a model, fitted to the same records."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, StateSpaceDynamics, StaticDynamics
from hammerstein.hysteresis import BoucWen, Hysteresis, RateDependent
from hammerstein.identification.axes_candidates import WORTHWHILE
from hammerstein.identification.behind import Behind, search_behind, sure_behind
from hammerstein.identification.choice import Trial, chosen, judged_squares, parameters_of
from hammerstein.identification.choices import HysteresisKind
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.axis_search import WORSE_DELAYS
from hammerstein.identification.linear.axis_task import parameters_of as axis_parameters
from hammerstein.identification.linear.delay import MOST_DELAY
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.static.asymmetric import fit_asymmetric
from hammerstein.identification.static.asymmetric_choice import AsymmetricChoice, chosen_asymmetric
from hammerstein.identification.static.bouc_wen import fit_bouc_wen
from hammerstein.identification.static.history import FEWEST, each_alone, judged_starts, unexplained
from hammerstein.identification.static.rate_dependent import TWO_RATES, fit_rate_dependent
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.static_block import SquaresSolver, Thresholds, half_swing
from hammerstein.identification.static_candidates import begun_static
from hammerstein.identification.task import Built, Found, Task
from hammerstein.identification.together import fitted_together
from hammerstein.identification.verdict import drive_hz, invertibility_of
from hammerstein.records.record import Record
from hammerstein.records.turning_points import turning_points

Linear = AxesDynamics | StaticDynamics | StateSpaceDynamics


MOST_TURNS = 4
"""Most times that block and axes are fitted in turn; each must lower the error by half a percent."""
DELAY_TURN = 1
"""Turn in which the delay is found: behind a block that was found in front of axes."""
SWING, SWINGS = 0.05, 2
"""Smallest swing that counts, in parts of the whole, and how many short and long ones are looked at."""
BEGINNING = 20_000
"""Samples of all records together that tell how they began."""


@dataclass(frozen=True, eq=False)
class Replacement:
    """A block of another kind, what is to be said of it, and the columns that were chosen if any were.

    ``rough`` asks of those that are to be like it no more than to be told apart.
    """

    hysteresis: Hysteresis[Any]
    notes: tuple[str, ...] = ()
    choice: AsymmetricChoice | None = None
    rough: bool = False


def with_hysteresis(task: Task, built: Built, held: Sequence[Record] = ()) -> tuple[Task, Built]:
    """The models with one of the kind of hysteresis that was asked for; ``classical`` keeps plays.

    Lag, resonance and creep are found anew behind the block itself, for what plays miss of it would pass for
    them; with dynamics ``auto`` only where the records are driven at several rates, for at a single one a lag
    looks like hysteresis. So does a delay: without dynamics every one is judged on the records held back, and
    where there are none it is the delay that was found with plays.

    Parameters
    ----------
    task : records and settings; its thresholds, delay and starts were found with plays
    built : the models with plays
    held : records on which it is judged what to keep; those of the fit if there are none

    Returns
    -------
    task : with the starts and the delay of the model that is kept
    built : the models with that one
    """
    settings, kind, with_plays = task.settings, task.settings.hysteresis, task.delay_samples
    task.progress(f"fitting the {kind.replace('_', ' ')} hysteresis")
    before = built.best
    task = task.delayed_as(before.candidate.dynamics)
    thresholds_v = [[pair.thresholds_v for pair in row] for row in before.blocks.chosen.hysteresis.pairs]
    tried = _late(task, thresholds_v, free=bool(held) and _free_delay(task))
    late = len(tried)
    if settings.dynamics != "auto" or several_rates(task.records):
        tried += [_with_axes(task, thresholds_v, tried[0].block)] if settings.dynamics != "none" else []
    trials = trials_of(task, tried, held)
    nearest = min(range(late), key=lambda i: trials[i].percent)
    kept = [nearest, *range(late, len(tried))]
    found = tried[kept[chosen([trials[i] for i in kept])]]
    task = replace(task, starts=found.starts, delay_samples=found.behind.delay_samples)
    name: Kind = "static_hysteresis" if found.behind.is_static else "hammerstein"
    axes = () if found.behind.is_static else found.behind.fits
    plays = {**built.found, "classical": before}
    if name == built.kind == "static_hysteresis" and task.delay_samples != with_plays:
        plays = _better(task, plays, _plays_of(task))
    models = {**plays, name: Found(found.candidate, before.blocks, axes)}
    notes = (*built.notes, *found.block.notes)
    return task, replace(built, found=models, kind=name, axes=axes, notes=notes)


def _plays_of(task: Task) -> dict[Kind, Found]:
    """Linear gain and plays, with the delay that a model without plays alone was kept with."""
    found = begun_static(task).found
    return {"linear": found["linear"], "classical": found["static_hysteresis"]}


def _better(task: Task, found: dict[Kind, Found], others: dict[Kind, Found]) -> dict[Kind, Found]:
    """Models of which those are replaced that another one of their kind leaves less of the records than."""

    def left(one: Found) -> float:
        return score(one.candidate, task.records, task.starts).mean_percent

    return {kind: min([one, others.get(kind, one)], key=left) for kind, one in found.items()}


def _late(task: Task, thresholds_v: Thresholds, free: bool) -> list[Whole]:
    """Blocks without dynamics: with the delay known, or with longer ones until two leave more."""
    if not free:
        return [_before(task, thresholds_v, Behind((), task.delay_samples))]
    found: list[Whole] = []
    left: list[float] = []
    for delay in range(MOST_DELAY + 1):
        found.append(_before(task, thresholds_v, Behind((), delay)))
        left.append(score(found[-1].candidate, task.records, task.starts).mean_percent)
        if delay - int(np.argmin(left)) >= WORSE_DELAYS:
            break
    return found


def _free_delay(task: Task) -> bool:
    """Whether the delay is to be found: thresholds that grow with the rate look like one."""
    one_time = len({record.sample_time_s for record in task.records}) == 1
    return task.settings.delay_samples is None and one_time and task.settings.hysteresis != "rate_dependent"


def several_rates(records: Sequence[Record]) -> bool:
    """Whether records are driven so fast and so slowly that they tell a lag from hysteresis."""
    rates = [drive_hz(record) for record in records]
    within = (_fast_and_slow(u) for record in records for u in record.u_v if np.ptp(u) > 0.0)
    return max(rates) > TWO_RATES * min(rates) or any(within)


def _fast_and_slow(u: Array) -> bool:
    """Whether one voltage has swings that are both shorter and faster than others of it.

    At one speed a lag looks like a play, at one frequency like hysteresis.
    """
    points = turning_points(u, SWING * float(np.ptp(u)))
    samples, volts = np.diff(points)[1:-1], np.abs(np.diff(u[points]))[1:-1]  # the ends are parts of swings
    if len(samples) < 2 * SWINGS:
        return False
    order = np.argsort(samples, kind="stable")
    short, long = order[:SWINGS], order[-SWINGS:]
    times = samples[long].mean() / samples[short].mean()
    speeds = (volts / samples)[short].mean() / (volts / samples)[long].mean()
    return bool(min(times, speeds) > TWO_RATES)


def trials_of(task: Task, tried: Sequence[Whole], held: Sequence[Record]) -> list[Trial]:
    """What speaks for each model: its errors on the records held back, or else on those of the fit.

    All are judged on the same samples: a beginning that one of them explains counts for all.
    """
    record, swing = task.records[0], float(half_swing(task.records).max())
    judged, found = held or task.records, []
    for one in tried:
        squares = judged_squares(one.candidate, judged, _judged_alike(task, one, tried, held))
        block, dynamics = one.candidate.hysteresis.counted_from(record.rest_v), one.candidate.dynamics
        told = invertibility_of(block, dynamics, swing, record.sample_time_s, record.inputs)[0]
        found.append(Trial(one.name, parameters_of(one.candidate), squares, told))
    return found


def _judged_alike(
    task: Task, one: Whole, tried: Sequence[Whole], held: Sequence[Record]
) -> tuple[Start, ...]:
    """Starts with which one of several models is judged; those that it was fitted with where they explain."""
    simpler = [other.candidate.predict for other in tried if other is not one]
    settle_s = max(other.settle_s for other in tried)

    def judge(records: Sequence[Record]) -> tuple[Start, ...]:
        return judged_starts(records, one.candidate.predict, settle_s, task.settings.start, simpler)

    if held:
        return judge(held)
    open_ = unexplained(task.records, one.starts)
    again = dict(zip(open_, judge([task.records[i] for i in open_]), strict=True))
    return tuple(again.get(i, start) for i, start in enumerate(one.starts))


class Whole(NamedTuple):
    """A block with what stands behind it."""

    candidate: Candidate
    behind: Behind
    block: Replacement
    starts: tuple[Start, ...]

    @property
    def name(self) -> str:
        """Words for a table."""
        shapes = dict.fromkeys(axis_parameters(axis)[0].name for axis in self.behind.axes)
        return ", ".join(shapes) or f"{self.behind.delay_samples:g} samples late"

    @property
    def settle_s(self) -> float:
        """Time in which the slowest axis, without its creep, rings down to a thousandth [s]."""
        axes = self.behind.axes
        times = [axis.lag_s for axis in axes if axis.lag_s is not None]
        for axis in axes:
            if axis.resonance_hz is not None and axis.damping_ratio is not None:
                times.append(0.5 / np.pi / axis.resonance_hz / axis.damping_ratio)
        return float(np.log(1e3)) * max(times, default=0.0)


def _with_axes(task: Task, thresholds_v: Thresholds, alone: Replacement) -> Whole:
    """Block, axes and starts fitted in turn until nothing is gained.

    The block is fitted with its bounds and all that is not linear in it, the axes with its weights. Columns
    are chosen in every turn: in front of axes that are not yet what they come to, too few pass for enough.

    alone : the block as it was found without axes
    """
    free, least = _free_delay(task), math.inf
    found = Behind((), 0.0 if free else task.delay_samples)
    whole = _before(task, thresholds_v, found, alone)
    for turn in range(MOST_TURNS):
        late = free and turn == DELAY_TURN
        found = search_behind(task, whole.block.hysteresis, found, late)
        whole, found = _in_front(task, thresholds_v, whole.block, found, anew=True)
        starts = _starts_behind(task, thresholds_v, whole)
        moved = starts != task.starts
        if moved:
            task = replace(task, starts=starts)
            whole, found = _in_front(task, thresholds_v, whole.block, found, anew=False)
        error = score(whole.candidate, task.records, task.starts).mean_percent
        if error > (1.0 - WORTHWHILE) * least and not moved:
            break
        least = error
    return _before(task, thresholds_v, sure_behind(task, whole.block.hysteresis, found), whole.block)


def _in_front(
    task: Task, thresholds_v: Thresholds, block: Replacement, found: Behind, *, anew: bool
) -> tuple[Whole, Behind]:
    """Block in front of the axes found, and the axes again where both were fitted together.

    ``anew`` chooses the columns again; otherwise they stay those of ``block``.
    """
    if not isinstance(block.hysteresis, RateDependent) or found.is_static:
        return _before(task, thresholds_v, found, None if anew else block), found
    task.progress("fitting the block together with what stands behind it")
    hysteresis, found = fitted_together(task, block.hysteresis, found)
    return _before(task, thresholds_v, found, Replacement(hysteresis)), found


def _starts_behind(task: Task, thresholds_v: Thresholds, whole: Whole) -> tuple[Start, ...]:
    """Starts that suit a model with axes.

    What a record did not tell before lag and creep were known is asked again: slow modes that are fitted as
    if a record had gone before itself make its true past look wrong, so that the weights are fitted anew.
    """
    mode = task.settings.start
    starts = judged_starts(task.records, whole.candidate.predict, whole.settle_s, mode)
    if mode != "auto":
        return starts
    most = max(BEGINNING // len(task.records), FEWEST)
    parts = tuple(record.part(0, min(record.samples, most)) for record in task.records)
    quick, rough = replace(task, records=parts), replace(whole.block, rough=True)

    def fit(starts: Sequence[Start]) -> Callable[[Record, Start], Array]:
        begun = replace(quick, starts=tuple(starts))
        return _before(begun, thresholds_v, whole.behind, rough).candidate.predict

    return each_alone(quick.records, starts, fit, unexplained(task.records, starts))


def _before(task: Task, thresholds_v: Thresholds, found: Behind, like: Replacement | None = None) -> Whole:
    """Block before the axes found, with the columns of another one if it is given."""
    late = replace(task, delay_samples=found.delay_samples)
    dynamics = StaticDynamics(n_outputs=task.outputs) if found.is_static else found.dynamics
    block = REPLACEMENTS[task.settings.hysteresis](late, thresholds_v, dynamics, like)
    return Whole(late.candidate(block.hysteresis, dynamics), found, block, task.starts)


def _asymmetric(
    task: Task, thresholds_v: Thresholds, dynamics: Linear, like: Replacement | None
) -> Replacement:
    """Dead-zones beside the plays, as many as the records call for unless their number is given."""
    settings, paths = task.settings, task.paths(dynamics)
    free = settings.operators == "auto" and settings.thresholds_v is None and settings.partition == "auto"
    begun = [[np.concatenate([[0.0], r[1:]]) if r.size else r for r in row] for row in thresholds_v]
    behind: dict[str, Any] = {"starts": task.starts, "delay_samples": task.whole_delay, "through": paths}
    choice = like.choice if like else None
    if choice is None:
        task.progress("trying numbers of plays and dead-zones")
        choice = chosen_asymmetric(task.records, None if free else begun, settings.dead_zones, **behind)
    solver: SquaresSolver = "invertible" if settings.solver == "closed_form" else settings.solver
    fit = fit_asymmetric(
        task.records,
        choice.thresholds_v,
        choice.breakpoints_v,
        solver=solver,
        ridge=settings.ridge or choice.ridge,
        **behind,
    )
    count = len(choice.breakpoints_v[0])
    told = f"{count} dead-zones an input stand beside the plays"
    return Replacement(fit.hysteresis, (told, *_bounded(task, fit.held)), choice)


def _rate_dependent(
    task: Task, thresholds_v: Thresholds, dynamics: Linear, like: Replacement | None
) -> Replacement:
    """Plays whose thresholds grow with the rate; the outputs share those of an input."""
    grids = [np.unique(np.concatenate([[0.0], *(row[k][1:] for row in thresholds_v)]))
             for k in range(len(thresholds_v[0]))]  # fmt: skip
    fit = fit_rate_dependent(
        task.records,
        grids,
        invertible=task.settings.solver == "invertible",
        starts=task.starts,
        delay_samples=task.whole_delay,
        through=task.paths(dynamics),
        like=like.hysteresis if like and isinstance(like.hysteresis, RateDependent) else None,
    )
    told = [
        f"thresholds of {name} grow by {float(plays.growth_s[-1]):.3g} V for each V/s, seen through "
        f"{plays.bandwidth_hz:.3g} Hz"
        for name, plays in zip(task.records[0].inputs, fit.hysteresis.inputs, strict=True)
    ]
    late = f"a delay of {task.delay_samples:g} samples was taken as known: it looks like growing thresholds"
    return Replacement(fit.hysteresis, (*told, late))


def _bouc_wen(
    task: Task, thresholds_v: Thresholds, dynamics: Linear, like: Replacement | None
) -> Replacement:
    """The Bouc-Wen model, which has no thresholds."""
    fit = fit_bouc_wen(
        task.records,
        invertible=task.settings.solver == "invertible",
        starts=task.starts,
        delay_samples=task.whole_delay,
        through=task.paths(dynamics),
        like=like.hysteresis if like and isinstance(like.hysteresis, BoucWen) else None,
        rough=like is not None and like.rough,
    )
    record = task.records[0]
    notes = [
        f"from {name} to {output}: beta {pair.beta_per_v:.3g}, gamma {pair.gamma_per_v:.3g} 1/V"
        for output, row in zip(record.outputs, fit.hysteresis.pairs, strict=True)
        for name, pair in zip(record.inputs, row, strict=True)
    ]
    return Replacement(fit.hysteresis, (*notes, *_bounded(task, fit.held)))


def _bounded(task: Task, held: Sequence[tuple[int, int]]) -> list[str]:
    record = task.records[0]
    return [
        f"slopes from {record.inputs[k]} to {record.outputs[o]} held at a bound, or there were no inverse"
        for o, k in held
    ]


REPLACEMENTS: Mapping[
    HysteresisKind, Callable[[Task, Thresholds, Linear, Replacement | None], Replacement]
] = {
    "asymmetric": _asymmetric,
    "rate_dependent": _rate_dependent,
    "bouc_wen": _bouc_wen,
}
