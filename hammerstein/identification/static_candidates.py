"""Candidate models without dynamics: linear gain, and static hysteresis with initial or fitted thresholds."""

from dataclasses import replace
from typing import Any

from hammerstein.arrays import Array
from hammerstein.dynamics import AxesDynamics, Dynamics, StaticDynamics
from hammerstein.errors import IdentificationError
from hammerstein.identification.fit import Kind
from hammerstein.identification.linear.axis_search import thinning
from hammerstein.identification.linear.delay import best_delay
from hammerstein.identification.model_selection import lowers
from hammerstein.identification.operators import CURVE_SAMPLES
from hammerstein.identification.score import SensorModel, invertibility_of
from hammerstein.identification.static.closed_form import closed_form_model
from hammerstein.identification.static.initial_state import closed, shortened
from hammerstein.identification.static.regressors import InitialState
from hammerstein.identification.static.static_block import (
    SlopeColumns,
    SquaresSolver,
    StaticFit,
    Thresholds,
    fit_static,
    half_swing,
    refuse_unreached,
    solve_static,
    static_moments,
)
from hammerstein.identification.static.threshold_search import ThresholdTask, fit_thresholds, gained
from hammerstein.identification.task import CandidateSet, FittedModel, Task, WeightFits

MOST_ROUNDS = 8
"""Most rounds of a fit of thresholds."""
KEPT = "fitted thresholds do not lower the error: they are uniform in time"


def build_static(task: Task) -> CandidateSet:
    """Linear gain and static hysteresis, the latter with fitted thresholds if requested and better."""
    return finished_static(task, begun_static(task))


def begun_static(task: Task) -> CandidateSet:
    """Linear gain and static hysteresis with the thresholds of the task."""
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the static block")
    starts = (InitialState("rest"),) * len(task.records)
    # its own delay, the same beside hysteresis of any kind, and all samples
    gain = late_static(replace(task, thresholds_v=task.linear_thresholds(), starts=starts))
    linear = static_blocks(gain, gain.thresholds_v, dynamics, "least_squares")
    blocks = static_blocks(task, task.thresholds_v, dynamics, task.settings.solver)
    found: dict[Kind, FittedModel] = {
        "linear": FittedModel(gain.candidate(linear.chosen.hysteresis, dynamics), linear),
        "static_hysteresis": FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks),
    }
    return CandidateSet(found, "static_hysteresis")


def finished_static(task: Task, built: CandidateSet) -> CandidateSet:
    """Static hysteresis with fitted thresholds, if requested and better; otherwise unchanged."""
    if not task.settings.fits_thresholds:
        return built
    dynamics = StaticDynamics(n_outputs=task.outputs)
    task.progress("fitting the thresholds")
    thresholds_v, prompt = fitted_thresholds(task, task.thresholds_v, dynamics), task
    late = late_static(replace(task, thresholds_v=thresholds_v))
    if late.delay_samples != task.delay_samples:
        prompt, task = replace(task, delay_samples=0.0), replace(task, delay_samples=late.delay_samples)
        thresholds_v = fitted_thresholds(task, thresholds_v, dynamics)
    blocks = of_fitted(task, thresholds_v, dynamics)
    if prompt is not task:  # on a ramp, wrong thresholds make up for a wrong delay: neither search sees it
        other = of_fitted(prompt, fitted_thresholds(prompt, task.thresholds_v, dynamics), dynamics)
        if lowers(*(float(one.chosen.rms_um.mean()) for one in (other, blocks))):
            task, blocks = prompt, other
    begun = built.best.blocks
    if not gained(begun.chosen, blocks.chosen) or lost_inverse(task, begun, blocks):
        return replace(built, notes=(KEPT,) if task.settings.partition == "fitted" else ())
    found = FittedModel(task.candidate(blocks.chosen.hysteresis, dynamics), blocks)
    return replace(built, found={**built.found, built.kind: found})


def late_static(task: Task) -> Task:
    """The task with the best delay for its thresholds without dynamics, if none was given.

    Single loops cannot tell it from hysteresis, and coarse thresholds look like a delay.
    """
    if task.settings.delay_samples is not None or all(closed(record) for record in task.records):
        return task
    few, begun = shortened(task.records, task.starts, CURVE_SAMPLES)
    sensor = replace(task, records=few).paths(StaticDynamics(n_outputs=task.outputs))

    def attempt(delay: float, _: None) -> tuple[list[float], None]:
        known: dict[str, Any] = {"starts": begun, "delay_samples": round(delay), "through": sensor or None}
        return fit_static(few, task.thresholds_v, solver="least_squares", **known).rms_um.tolist(), None

    return replace(task, delay_samples=best_delay(attempt, None)[0])


def static_blocks(task: Task, thresholds_v: Thresholds, dynamics: Dynamics, solver: str) -> WeightFits:
    """Weights by the requested solver, and by two others for comparison."""
    layout = SlopeColumns.of(thresholds_v)
    refuse_unreached(task.records, layout.grids)
    moments = static_moments(
        task.records, layout.grids, task.starts, task.whole_delay, task.paths(dynamics) or None
    )

    def solved(how: SquaresSolver) -> StaticFit:
        return solve_static(task.records, thresholds_v, layout, moments, how, task.settings.ridge)

    free = solved("least_squares")
    if solver == "closed_form":
        return WeightFits(_closed_form(task, free), free, solved("nonnegative"))
    chosen = {"least_squares": free, "nonnegative": solved("nonnegative"), "invertible": solved("invertible")}
    return WeightFits(chosen[solver], free, chosen["nonnegative"])


def _closed_form(task: Task, free: StaticFit) -> StaticFit:
    """Closed form on the settled loops, brought forward by the delay."""
    d = task.whole_delay
    prompt = [SensorModel(delay_s=d * record.sample_time_s).prompt(record) for record in task.records]
    placed = task.settings.thresholds_v is not None or task.settings.partition == "voltage"
    given = task.thresholds_v if placed else None
    counts = {len(r) for row in task.thresholds_v for r in row}
    if given is None and len(counts) > 1:
        raise IdentificationError("the closed form places one number of thresholds; give one, or thresholds")
    return replace(free, hysteresis=closed_form_model(prompt, max(counts), given), bounded=(), open=())


def without_dynamics(task: Task) -> Task:
    """The task with the best delay for a model without dynamics."""
    own = task.static_delay_samples
    return task if own is None else replace(task, delay_samples=own)


def of_fitted(task: Task, thresholds_v: Thresholds, dynamics: AxesDynamics | StaticDynamics) -> WeightFits:
    """Weights for fitted thresholds."""
    return replace(static_blocks(task, thresholds_v, dynamics, task.settings.solver), fitted=True)


def lost_inverse(task: Task, start: WeightFits, found: WeightFits) -> bool:
    """Whether fitting the thresholds made the static block non-invertible."""
    amplitude, record = float(half_swing(task.records).max()), task.records[0]
    told = StaticDynamics(n_outputs=task.outputs)
    before, now = (
        invertibility_of(b.chosen.hysteresis, told, amplitude, record.sample_time_s, record.inputs)[0]
        for b in (start, found)
    )
    return before and not now


def fitted_thresholds(
    task: Task, thresholds_v: Thresholds, dynamics: Dynamics, rounds: int = MOST_ROUNDS
) -> list[list[Array]]:
    """Thresholds fitted in front of given dynamics, the same for all outputs."""
    known = task.starts, task.whole_delay, task.paths(dynamics)
    fitting = ThresholdTask(task.records, *known, thinning(task.records))
    return [list(fit_thresholds(fitting, thresholds_v[0], rounds))] * task.outputs
