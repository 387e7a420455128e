"""The kinds of model that are fitted beside each other, so that each block must earn its place."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import AxesDynamics, LinearBlock, StateSpaceDynamics, StaticDynamics, discretise
from hammerstein.errors import IdentificationError
from hammerstein.hysteresis import PrandtlIshlinskii
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.coupled import fit_linear, fit_static_coupled, refit_linear
from hammerstein.identification.linear.second_order import AxesFit, AxisFit, FirstGuess, fit_axes
from hammerstein.identification.score import Candidate, score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.fitted_thresholds import criterion, fit_thresholds, gained
from hammerstein.identification.static.regressors import Start
from hammerstein.identification.static.settled_loops import closed_form_model
from hammerstein.identification.static.static_block import (
    Layout,
    StaticFit,
    Thresholds,
    Weighting,
    half_swing,
    refuse_unreached,
    solve_static,
    static_moments,
)
from hammerstein.identification.static.threshold_errors import with_threshold_errors
from hammerstein.identification.static.threshold_search import ThresholdTask
from hammerstein.identification.verdict import FELT, axis_identified, invertibility_of
from hammerstein.records.record import Record

MOST_ROUNDS = 8
"""Most times that the two blocks are fitted in turn; each must gain a fiftieth."""
MOST_TURNS = 8
"""Most times that thresholds and axes are fitted in turn; each must lower the criterion by one."""
PATIENCE = 2
"""Turns in a row without that, after which they end."""
KEPT = "fitting the thresholds gains nothing: they are uniform in time"

Array = NDArray[np.float64]
Progress = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Task:
    """Records with all that is known before the candidates are fitted."""

    records: tuple[Record, ...]
    starts: tuple[Start, ...]
    thresholds_v: Thresholds
    delay_samples: int
    settings: Settings
    progress: Progress

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.records[0].y_um)

    @property
    def delay_s(self) -> float:
        """Delay of the inputs [s]."""
        return self.delay_samples * self.records[0].sample_time_s

    def linear_thresholds(self) -> list[list[Array]]:
        """Give a single threshold of 0 to every pair: a linear gain."""
        return [[np.zeros(min(len(r), 1)) for r in row] for row in self.thresholds_v]

    def paths(self, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics) -> list[LinearBlock]:
        """Discrete path of each record from the static block to the reading, without delay."""
        prompt = dynamics.model_copy(update={"input_delay_s": 0.0})
        sensor = self.settings.sensor_bandwidth_hz
        if isinstance(prompt, StaticDynamics) and sensor is None:
            return []
        return [discretise(prompt, record.sample_time_s, sensor) for record in self.records]

    def candidate(
        self,
        hysteresis: PrandtlIshlinskii,
        dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    ) -> Candidate:
        """Static block and linear block as a model with the delay of the task."""
        late = dynamics.model_copy(update={"input_delay_s": self.delay_s})
        return Candidate(hysteresis, late, self.settings.sensor_bandwidth_hz)


@dataclass(frozen=True, eq=False)
class Blocks:
    """A static block under several methods, behind one and the same linear block.

    ``chosen`` is by the method that was asked for; ``free`` and ``one_sign`` serve for comparison.
    """

    chosen: StaticFit
    free: StaticFit
    one_sign: StaticFit | None


@dataclass(frozen=True, eq=False)
class Built:
    """All candidates, and what only the largest of them tells."""

    candidates: dict[Kind, Candidate]
    kind: Kind
    blocks: Blocks
    axes: tuple[AxisFit, ...] = ()
    notes: tuple[str, ...] = ()


def build_static(task: Task) -> Built:
    """Linear gain and static hysteresis, the latter with fitted thresholds if they are asked for and gain."""
    return _finished(task, _begun_static(task))


def _begun_static(task: Task) -> Built:
    """Linear gain and static hysteresis with the thresholds of the task."""
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the static block")
    linear = static_blocks(task, task.linear_thresholds(), dynamics, "least_squares")
    blocks = static_blocks(task, task.thresholds_v, dynamics, task.settings.method)
    candidates: dict[Kind, Candidate] = {
        "linear": task.candidate(linear.chosen.hysteresis, dynamics),
        "static_hysteresis": task.candidate(blocks.chosen.hysteresis, dynamics),
    }
    return Built(candidates, "static_hysteresis", blocks)


def _finished(task: Task, built: Built) -> Built:
    """Static hysteresis with fitted thresholds if they are asked for; as it was if nothing is gained."""
    if task.settings.partition != "fitted":
        return built
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the thresholds")
    thresholds_v = _fitted(task, task.thresholds_v, dynamics)
    blocks = static_blocks(task, thresholds_v, dynamics, task.settings.method)
    if not gained(built.blocks.chosen, blocks.chosen) or _lost_inverse(task, built.blocks, blocks):
        return replace(built, notes=(KEPT,))
    blocks = _with_errors(task, blocks, dynamics)
    candidate = task.candidate(blocks.chosen.hysteresis, dynamics)
    return replace(built, candidates={**built.candidates, built.kind: candidate}, blocks=blocks)


def static_blocks(
    task: Task,
    thresholds_v: Thresholds,
    dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    method: str,
) -> Blocks:
    """Weights by the method asked for, and by the two that it is compared with."""
    layout = Layout.of(thresholds_v)
    refuse_unreached(task.records, layout.grids)
    moments = static_moments(
        task.records, layout.grids, task.starts, task.delay_samples, task.paths(dynamics) or None
    )

    def solved(how: Weighting) -> StaticFit:
        return solve_static(task.records, thresholds_v, layout, moments, how, task.settings.ridge)

    free = solved("least_squares")
    if method == "closed_form":
        return Blocks(_closed_form(task, free), free, solved("nonnegative"))
    chosen = {
        "least_squares": free,
        "nonnegative": solved("nonnegative"),
        "invertible": solved("invertible"),
    }
    return Blocks(chosen[method], free, chosen["nonnegative"])


def _closed_form(task: Task, free: StaticFit) -> StaticFit:
    """Closed form on the settled loops, brought forward by the delay."""
    settings = task.settings
    d = task.delay_samples
    prompt = [
        Record(
            record.u_v[:, : record.samples - d],
            record.y_um[:, d:],
            record.sample_time_s,
            record.inputs,
            record.outputs,
            record.source,
            verified=True,
        )
        for record in task.records
    ]
    placed = settings.thresholds_v is not None or settings.partition == "voltage"
    given = task.thresholds_v if placed else None
    counts = {len(r) for row in task.thresholds_v for r in row}
    if given is None and len(counts) > 1:
        raise IdentificationError("the closed form places one number of thresholds; give one, or thresholds")
    hysteresis = closed_form_model(prompt, max(counts), given)
    return replace(free, hysteresis=hysteresis, bounded=(), open=())


def build_second_order(task: Task, guess: FirstGuess) -> Built:
    """All four kinds, with second-order axes."""
    settings = task.settings
    static = _begun_static(task)
    fits: dict[bool, AxesFit] = {}
    for plays, thresholds_v in ((False, task.linear_thresholds()), (True, task.thresholds_v)):
        fits[plays] = fit_axes(
            task.records,
            Layout.of(thresholds_v).grids,
            task.starts,
            guess,
            creep_modes=settings.creep_modes,
            sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
            progress=task.progress if plays else None,
        )
    axes = fits[True].axes
    if not any(axis_identified(axis) for axis in axes):
        return replace(_finished(task, static), axes=axes)
    blocks = static_blocks(task, task.thresholds_v, dynamics_of(axes), settings.method)
    if not _felt(static.blocks.chosen, blocks.chosen):
        unfelt = [replace(axis, rms_um=axis.static_rms_um) for axis in axes]
        return replace(_finished(task, static), axes=tuple(unfelt))
    notes: tuple[str, ...] = ()
    if settings.partition == "fitted":
        start = blocks
        axes, blocks = _thresholds_and_axes(task, guess, axes, start)
        notes = (KEPT,) if blocks is start else ()
        blocks = blocks if blocks is start else _with_errors(task, blocks, dynamics_of(axes))
    dynamics = dynamics_of(axes)
    alone = dynamics_of(fits[False].axes)
    gains = static_blocks(task, task.linear_thresholds(), alone, "least_squares")
    candidates: dict[Kind, Candidate] = {
        **static.candidates,
        "linear_dynamics": task.candidate(gains.chosen.hysteresis, alone),
        "hammerstein": task.candidate(blocks.chosen.hysteresis, dynamics),
    }
    return Built(candidates, "hammerstein", blocks, axes, notes)


def _thresholds_and_axes(
    task: Task, guess: FirstGuess, axes: tuple[AxisFit, ...], blocks: Blocks
) -> tuple[tuple[AxisFit, ...], Blocks]:
    """Axes and static block with thresholds and axes fitted in turn; as they were if nothing is gained."""
    settings, free = task.settings, 1 + task.outputs
    best: tuple[tuple[AxisFit, ...], Blocks] | None = None
    near, thresholds_v, idle = axes, task.thresholds_v, 0
    for _ in range(MOST_TURNS):
        task.progress("fitting the thresholds")
        thresholds_v = _fitted(task, thresholds_v, dynamics_of(near), rounds=1)
        begin = np.log([[fit.axis.resonance_hz, fit.axis.damping_ratio] for fit in near])
        near = fit_axes(
            task.records,
            Layout.of(thresholds_v).grids,
            task.starts,
            replace(guess, parameters=begin),
            creep_modes=settings.creep_modes,
            sensor_bandwidth_hz=settings.sensor_bandwidth_hz,
        ).axes
        if not any(axis_identified(axis) for axis in near):
            break
        trial = static_blocks(task, thresholds_v, dynamics_of(near), settings.method)
        least = criterion(best[1].chosen, free) if best else math.inf
        worse = criterion(trial.chosen, free) >= least - 1.0 or _lost_inverse(task, blocks, trial)
        idle = idle + 1 if worse else 0
        if idle >= PATIENCE:
            break
        best = best if idle else (near, trial)
    return best if best and gained(blocks.chosen, best[1].chosen) else (axes, blocks)


def _lost_inverse(task: Task, start: Blocks, found: Blocks) -> bool:
    """Whether the static block had an inverse with the thresholds begun with, and has none any more."""
    amplitude, record = float(half_swing(task.records).max()), task.records[0]
    told = StaticDynamics(n_outputs=task.outputs)
    before, now = (
        invertibility_of(b.chosen.hysteresis, told, amplitude, record.sample_time_s, record.inputs)[0]
        for b in (start, found)
    )
    return before and not now


def _fitted(
    task: Task,
    thresholds_v: Thresholds,
    dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics,
    rounds: int = MOST_ROUNDS,
) -> list[list[Array]]:
    """Thresholds fitted in front of given dynamics, the same for all outputs."""
    row = list(fit_thresholds(_fitting(task, dynamics), thresholds_v[0], rounds))
    return [row] * task.outputs


def _with_errors(
    task: Task, blocks: Blocks, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics
) -> Blocks:
    """Blocks whose chosen one knows the errors of its fitted thresholds."""
    return replace(blocks, chosen=with_threshold_errors(_fitting(task, dynamics), blocks.chosen))


def _fitting(task: Task, dynamics: AxesDynamics | StaticDynamics | StateSpaceDynamics) -> ThresholdTask:
    """What stays fixed while thresholds are fitted in front of given dynamics."""
    return ThresholdTask(task.records, task.starts, task.delay_samples, task.paths(dynamics))


def _felt(without: StaticFit, with_dynamics: StaticFit) -> bool:
    """Whether dynamics lower the error of a static block that is bound to have an inverse."""
    return bool(np.any(with_dynamics.rms_um <= (1.0 - FELT) * without.rms_um))


def dynamics_of(axes: Sequence[AxisFit]) -> AxesDynamics | StateSpaceDynamics:
    """Linear block of the axes; those that the records do not tell pass their input unchanged."""
    told = [o for o, axis in enumerate(axes) if axis_identified(axis)]
    if len(told) in (0, len(axes)):
        return AxesDynamics(axes=tuple(fit.axis for fit in axes))
    system = AxesDynamics(axes=tuple(axes[o].axis for o in told)).system()
    n, p = system.nstates, len(axes)
    b, c, d = np.zeros((n, p)), np.zeros((p, n)), np.eye(p)
    b[:, told], c[told] = system.B, system.C
    d[told, told] = 0.0
    rows = (tuple(map(tuple, np.asarray(matrix).tolist())) for matrix in (system.A, b, c, d))
    return StateSpaceDynamics(**dict(zip("ABCD", rows, strict=True)))


def build_state_space(task: Task) -> Built:
    """All four kinds, with a state-space model of the order asked for."""
    settings = task.settings
    assert settings.order is not None  # refused by Settings
    static = build_static(task)
    task.progress("fitting the linear dynamics")
    block, gain = fit_linear(task.records, settings.order, task.progress)
    alone = task.candidate(_gain_model(gain), _state_space(block))
    task.progress("fitting the static block in front of them")
    blocks, best = _hammerstein(task, block)
    before, error = _error(task, alone), _error(task, best)
    told = len(task.records[0].u_v) == task.outputs  # or the outputs of the static block move together
    for _ in range(MOST_ROUNDS if told else 0):
        if error > (1.0 - FELT) * before:
            break
        task.progress("fitting the linear dynamics behind the static block")
        hysteresis = blocks.chosen.hysteresis
        again = refit_linear(task.records, task.starts, hysteresis, settings.order, task.progress)
        trial = _hammerstein(task, again)
        before, now = error, _error(task, trial[1])
        if now < error:
            (blocks, best), error = trial, now
    candidates: dict[Kind, Candidate] = {
        **static.candidates,
        "linear_dynamics": alone,
        "hammerstein": best,
    }
    return Built(candidates, "hammerstein", blocks)


def _error(task: Task, candidate: Candidate) -> float:
    return score(candidate, task.records, task.starts).mean_percent


def _hammerstein(task: Task, block: LinearBlock) -> tuple[Blocks, Candidate]:
    """Static block in front of a linear one."""
    blocks = _coupled(task, block)
    return blocks, task.candidate(blocks.chosen.hysteresis, _state_space(block))


def _coupled(task: Task, block: LinearBlock) -> Blocks:
    method = task.settings.method
    weighting: Weighting = "invertible" if method == "closed_form" else method
    found = fit_static_coupled(
        task.records, task.thresholds_v, block, task.starts, method=weighting, ridge=task.settings.ridge
    )
    return Blocks(found, found, None)


def _gain_model(gain: Array) -> PrandtlIshlinskii:
    return PrandtlIshlinskii.from_arrays(np.zeros(1), gain[:, :, None])


def _state_space(block: LinearBlock) -> StateSpaceDynamics:
    rows = {name: tuple(map(tuple, getattr(block, name).tolist())) for name in "ABCD"}
    return StateSpaceDynamics(**rows, sample_time_s=block.sample_time_s)
