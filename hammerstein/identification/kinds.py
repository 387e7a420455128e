"""Other kinds of hysteresis in place of the classical block of a model, fitted to the same records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import AxesDynamics, StateSpaceDynamics, StaticDynamics
from hammerstein.hysteresis import Hysteresis
from hammerstein.identification.candidates import Built, Task
from hammerstein.identification.settings import HysteresisKind
from hammerstein.identification.static.asymmetric import breakpoints_in, enough_dead_zones, fit_asymmetric
from hammerstein.identification.static.bouc_wen import fit_bouc_wen
from hammerstein.identification.static.rate_dependent import fit_rate_dependent
from hammerstein.identification.static.static_block import Thresholds, Weighting

Array = NDArray[np.float64]
Linear = AxesDynamics | StaticDynamics | StateSpaceDynamics


@dataclass(frozen=True, eq=False)
class Replacement:
    """A block of another kind, and what is to be said of it."""

    hysteresis: Hysteresis[Any]
    notes: tuple[str, ...] = ()


def with_hysteresis(task: Task, built: Built) -> Built:
    """The models with the kind of hysteresis that was asked for in the best one; ``classical`` keeps plays.

    Thresholds, delay and linear block are those that were found with plays.
    """
    kind = task.settings.hysteresis
    if kind == "prandtl_ishlinskii":
        return built
    task.progress(f"fitting the {kind.replace('_', ' ')} hysteresis")
    before = built.best
    task = task.delayed_as(before.candidate.dynamics)
    thresholds_v = [[pair.thresholds_v for pair in row] for row in before.blocks.chosen.hysteresis.pairs]
    found = REPLACEMENTS[kind](task, thresholds_v, before.candidate.dynamics)
    candidate = replace(before.candidate, hysteresis=found.hysteresis)
    models = {**built.found, "classical": before, built.kind: replace(before, candidate=candidate)}
    return replace(built, found=models, notes=(*built.notes, *found.notes))


def _asymmetric(task: Task, thresholds_v: Thresholds, dynamics: Linear) -> Replacement:
    """Dead-zones beside the plays, as many as the records call for unless their number is given."""
    settings, paths = task.settings, task.paths(dynamics)
    begun = [[np.concatenate([[0.0], r[1:]]) if r.size else r for r in row] for row in thresholds_v]
    count = settings.dead_zones
    if count is None:
        task.progress("trying numbers of dead-zones")
        count = enough_dead_zones(
            task.records, begun, starts=task.starts, delay_samples=task.whole_delay, through=paths
        )
    method: Weighting = "invertible" if settings.method == "closed_form" else settings.method
    fit = fit_asymmetric(
        task.records,
        begun,
        breakpoints_in(task.records, count),
        method=method,
        starts=task.starts,
        delay_samples=task.whole_delay,
        through=paths,
    )
    told = f"{count} dead-zones an input stand beside the plays"
    return Replacement(fit.hysteresis, (told, *_bounded(task, fit.held)))


def _rate_dependent(task: Task, thresholds_v: Thresholds, dynamics: Linear) -> Replacement:
    """Plays whose thresholds grow with the rate; the outputs share those of an input."""
    grids = [np.unique(np.concatenate([[0.0], *(row[k][1:] for row in thresholds_v)]))
             for k in range(len(thresholds_v[0]))]  # fmt: skip
    fit = fit_rate_dependent(
        task.records,
        grids,
        invertible=task.settings.method == "invertible",
        starts=task.starts,
        delay_samples=task.whole_delay,
        through=task.paths(dynamics),
    )
    told = [
        f"thresholds of {name} grow by {float(plays.growth_s[-1]):.3g} V for each V/s, seen through "
        f"{plays.bandwidth_hz:.3g} Hz"
        for name, plays in zip(task.records[0].inputs, fit.hysteresis.inputs, strict=True)
    ]
    late = f"a delay of {task.delay_samples:g} samples was taken as known: it looks like growing thresholds"
    return Replacement(fit.hysteresis, (*told, late))


def _bouc_wen(task: Task, thresholds_v: Thresholds, dynamics: Linear) -> Replacement:
    """The Bouc-Wen model, which has no thresholds."""
    fit = fit_bouc_wen(
        task.records,
        invertible=task.settings.method == "invertible",
        starts=task.starts,
        delay_samples=task.whole_delay,
        through=task.paths(dynamics),
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


REPLACEMENTS: Mapping[HysteresisKind, Callable[[Task, Thresholds, Linear], Replacement]] = {
    "asymmetric": _asymmetric,
    "rate_dependent": _rate_dependent,
    "bouc_wen": _bouc_wen,
}
