"""From a response to the rows of a report."""

import cmath
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.dynamics import AxesDynamics, StaticDynamics, on_grid
from hammerstein.errors import HammersteinError, SimulationError
from hammerstein.experiment.report import Condition, Target, Trace, told_apart
from hammerstein.experiment.set_up import Case, SetUp, Window
from hammerstein.hysteresis import Memory
from hammerstein.metrics import LoopFigures, Measured, Metric, Row, loop_figures, metrics_of
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Response, refuse_unbounded
from hammerstein.quantities import interval, length, number_of
from hammerstein.signals import OneFrequency

RECORDED_BLOCK = 100_000  # samples that are simulated at once where not all are recorded; they fit the cache


class PredictionState(NamedTuple):
    """Memory of a model's plays, and state (n,) of its linear block; None for a static model."""

    plays: Memory | None = None
    linear: Array | None = None


def recorded(setup: SetUp, case: Case) -> tuple[Response, Sequence[Target]]:
    """Response and targets of a case, on the samples that the scenario records.

    The models predict from every sample. A case that can be is simulated part by part.
    """
    every = setup.scenario.measure.record_every or 1
    long = every > 1 and setup.runs_on(case)
    block, recorded_part = max(RECORDED_BLOCK // every, 1) * every, slice(None, None, every)
    parts, targets, memory = [], [], dict[str, PredictionState]()
    for part in setup.blocks(case, block) if long else [setup.simulate(case)]:
        parts.append(part.every(every))
        targets.append([target.part(recorded_part) for target in targets_of(setup, case, part, memory)])
    return Response.joined(parts), [_joined(same) for same in zip(*targets, strict=True)]


def targets_of(
    setup: SetUp, case: Case, response: Response, memory: dict[str, PredictionState]
) -> Sequence[Target]:
    """Targets of a response, if any; the memory of the models, by label, is carried on."""
    if response.reference_um is not None:
        return [Target(case.label, response.reference_um, response.reference_um)]
    found = []
    for source in setup.scenario.models:
        if source.is_tested_at(case.signal.highest_frequency_hz):
            model, before = setup.models[source.label], memory.get(source.label, PredictionState())
            reading, position, memory[source.label] = _prediction(setup, model, response.drive_v, before)
            found.append(Target(source.label, reading, position))
    return found


def _prediction(
    setup: SetUp, model: HammersteinModel, drive_v: Array, start: PredictionState
) -> tuple[Array, Array, PredictionState]:
    """What a model predicts that the sensor reads, and where the actuator is."""
    model = model.on_grid(setup.plant.sample_time_s)
    v, plays = model.static_response(drive_v, start.plays)
    refuse_unbounded(f"prediction of {model.name}_um", v, setup.plant.sample_time_s)
    if isinstance(model.dynamics, StaticDynamics):
        return v, v, PredictionState(plays)  # found from readings: it stands for both
    plant = setup.plant
    block = on_grid(model.dynamics, plant.sample_time_s, plant.instruments.sensor.bandwidth_hz)
    both, linear = block.respond(v, start.linear)
    refuse_unbounded(f"prediction of {model.name}_um", both, plant.sample_time_s)
    position, reading = np.split(both, 2)
    return reading, position, PredictionState(plays, linear)


def _joined(parts: Sequence[Target]) -> Target:
    """Put the parts of one target together."""
    if len(parts) == 1:
        return parts[0]
    reading = np.concatenate([part.reading_um for part in parts], axis=1)
    return Target(parts[0].label, reading, np.concatenate([part.position_um for part in parts], axis=1))


SETTLED_FRACTION = 1e-3  # cycles may differ by this part of the range, beside the sensor's noise
LONGER = (2, 20)  # times the cycles before the measurement that are tried
WHOLE = 1e-6  # part of a sample by which a whole number of them may miss
MOST_SAMPLES = 4_000_000  # a longer run is not tried


def settled(setup: SetUp, case: Case, response: Response) -> bool:
    """Whether the last measured cycle of the true position repeats an earlier one.

    The earlier one is the first measured cycle. If its samples have other phases, it is the latest cycle with
    the same phases, because the response between two samples differs from cycle to cycle without being
    unsettled.
    """
    cycles = setup.scenario.measure.measured_cycles
    if not isinstance(case.signal, OneFrequency) or not case.signal.repeats or cycles < 2:
        return True
    samples = case.signal.period_s / response.sample_time_s
    last = Window.of(setup.scenario, case.signal, response.sample_time_s).first + round(
        (cycles - 1) * samples
    )
    alike = _cycles_of_whole_samples(samples, int(last / samples))
    back = {cycles - 1, alike * math.ceil((cycles - 1) / alike)} if alike else {cycles - 1}
    return any(_repeats(response.position_um, last, some, samples) for some in back if some * samples <= last)


def _cycles_of_whole_samples(samples: float, most: int) -> int:
    """Fewest cycles, of so many samples each, that have a whole number of them; 0 if more than ``most``.

    >>> _cycles_of_whole_samples(2000 / 7, 10), _cycles_of_whole_samples(2000 / 7, 6)
    (7, 0)
    """
    cycles = Fraction(samples).limit_denominator(max(most, 1)).denominator
    return cycles if abs(cycles * samples - round(cycles * samples)) < WHOLE else 0


def _repeats(position: Array, start: int, cycles: int, samples: float) -> bool:
    """Whether the cycle that starts at a sample agrees with that so many cycles before it."""
    lag = round(cycles * samples)
    now = position[:, start : start + int(samples)]
    then = position[:, start - lag :][:, : now.shape[1]]
    fraction = abs(lag / samples - cycles)
    allowed = (SETTLED_FRACTION + 2.0 * np.pi * fraction) * float(np.ptp(position))
    return float(np.abs(then - now).max()) <= allowed + 1e-9


def advice(setup: SetUp, case: Case) -> str:
    """Advice for a run that has not settled: a longer wait, or the reason why that does not help.

    The run is done again with 2 and with 20 times as many cycles before the measurement.
    """
    cycles = max(1, Window.of(setup.scenario, case.signal, setup.plant.sample_time_s).settle_cycles)
    for factor in LONGER:
        measure = setup.scenario.measure.model_copy(update={"settle_cycles": factor * cycles})
        longer = replace(setup, scenario=setup.scenario.model_copy(update={"measure": measure}))
        if Window.of(longer.scenario, case.signal, setup.plant.sample_time_s).total > MOST_SAMPLES:
            return "the run is too long to try more cycles"
        try:
            if settled(longer, case, longer.simulate(case)):
                return f"it settles with measure.settle_cycles = {factor * cycles}"
        except HammersteinError:
            return "it diverges in a longer run"
    return f"it does not settle in {LONGER[-1]} times as many cycles either: {_why(setup, case)}"


def _why(setup: SetUp, case: Case) -> str:
    law, dynamics = setup.laws.get(case.label), setup.plant.model.dynamics
    if isinstance(law, InverseMultiplicativeLaw) and not law.convergence.converges:
        return "the iteration of the law does not converge"
    if isinstance(dynamics, AxesDynamics) and any(axis.creep for axis in dynamics.axes):
        slowest = max(mode.time_constant_s for axis in dynamics.axes for mode in axis.creep)
        return f"the actuator creeps, with time constants up to {slowest:g} s"
    return "the cycles keep changing"


LAGGING = 2.0  # reading against true position: from here on most of the error is the sensor's
BEYOND = 0.02  # part of the recorded range by which a drive may leave it before that is said
HOLD_SHARE = 0.01  # of the amplitude; a hold that costs more is told
SIMULATED = "the simulated actuator"
FLAGGED = "flagged by its fit report"
ITSELF = "designed from the simulated actuator itself"
FAR = (
    "but the model was identified from {low:.4g} to {high:.4g} V and is unknown beyond: identify it "
    "over a larger range (amplitude_v), or use a smaller signal."
)
FAR_ITSELF = (
    "but it was recorded from {low:.4g} to {high:.4g} V. Its motion beyond is unknown: give its "
    "drive a range (instruments.drive.range_v), or use a smaller signal."
)


class Result(NamedTuple):
    """Rows of one case, its measured trace, advice if it had not settled, and clipped samples.

    unsettled : empty if it had; clipped : samples at the sensor's range
    """

    rows: tuple[Row, ...]
    trace: Trace
    unsettled: str
    clipped: int


def rows_of(setup: SetUp, case: Case) -> Result:
    """Simulate one case and measure it."""
    response, targets = recorded(setup, case)
    _refuse_still(setup, case, response)
    window = Window.of(setup.scenario, case.signal, response.sample_time_s)
    loops = _loops(setup, case, response, window)
    rows = tuple(_rows(setup, case, response, targets, setup.scenario.metrics(), loops))
    predicted = targets if setup.scenario.drive is not None else ()
    predictions = tuple(target.part(slice(window.first, None)) for target in predicted)
    trace = trace_of(setup, case, response.after(window.first), window.first, predictions)
    unsettled = "" if settled(setup, case, response) else advice(setup, case)
    clipped = setup.plant.instruments.sensor.clipped(response.reading_um[:, window.first :])
    return Result(rows, trace, unsettled, clipped)


def trace_of(
    setup: SetUp, case: Case, measured: Response, first: int, predictions: tuple[Target, ...]
) -> Trace:
    """Trace of a case from its first measured sample on."""
    axis = setup.excited_axis(case)
    return Trace(case.label, case.signal, axis, measured, first, predictions, case.trial)


def _refuse_still(setup: SetUp, case: Case, response: Response) -> None:
    """Refuse a drive in volts of which the converter leaves nothing: no loop and no error."""
    if setup.scenario.drive is None or np.ptp(response.drive_v, axis=1).any():
        return
    drive = setup.plant.instruments.drive
    low, high = drive.limits(len(response.drive_v))[:, case.axis or 0]
    still_v = response.drive_v[case.axis or 0, -1] + 0.0  # no -0
    raise SimulationError(
        f"the drive is constant at {still_v:.4g} V: its converter has steps of "
        f"{drive.resolution_v:.3g} V and a range of {low:g} to {high:g} V. Use a larger amplitude, or "
        "an offset within the range"
    )


def drawn_rows(setup: SetUp, case: Case, response: Response) -> tuple[Row, ...]:
    """Rows of one case with only those figures that have a band for an uncertain actuator."""
    drawn = [metric for metric in metrics_of() if metric.drawn]
    return tuple(_rows(setup, case, response, targets_of(setup, case, response, {}), drawn))


def _rows(
    setup: SetUp,
    case: Case,
    response: Response,
    targets: Sequence[Target],
    wanted: Sequence[Metric],
    loops: Sequence[LoopFigures] | None = None,
) -> Iterator[Row]:
    """Rows target by target, within each of them axis by axis."""
    first = Window.of(setup.scenario, case.signal, response.sample_time_s).first
    axes, key = setup.plant.model.outputs, _key(setup, case)
    path = response.reference_um if case.axis is None else None
    middle = None if path is None else case.signal.middle(len(path), np.zeros(len(path)))
    samples = case.signal.period_s / response.sample_time_s
    several = case.signal.repeats and setup.scenario.measure.measured_cycles > 1
    whole = round(samples) if several and abs(samples - round(samples)) < 1e-6 else None
    for target in targets or (None,):
        measured = Measured(
            response.sample_time_s,
            response.reading_um[:, first:],
            response.position_um[:, first:],
            response.saturated[:, first:],
            None if target is None else target.reading_um[:, first:],
            None if target is None else target.position_um[:, first:],
            None if path is None else path[:, first:],
            whole,
            loops,
            middle,
        )
        label = case.label if target is None else target.label
        found = {metric.name: metric.values(measured) for metric in wanted}
        for i, axis in enumerate(axes):
            figures = {name: value for name, values in found.items() if (value := values[i]) is not None}
            yield Row(compensator=label, measured_axis=axis, **key, figures=figures)


def _key(setup: SetUp, case: Case) -> dict[str, Any]:
    """Key of the rows of a case, whatever the response is compared with."""
    signal = case.signal.model_dump()
    return {
        "excited_axis": setup.excited_axis(case),
        "frequency_hz": case.signal.highest_frequency_hz,
        "amplitude_v": signal.get("amplitude_v", signal.get("radius_v")),
        "amplitude_um": signal.get("amplitude_um", signal.get("radius_um")),
        "trial": case.trial,
    }


def empty_rows_of(setup: SetUp, case: Case) -> list[Row]:
    """Rows of a case, still without figures."""
    labels = [source.label for source in setup.scenario.models] or [""]
    key = _key(setup, case)
    return [
        Row(compensator=label, measured_axis=axis, **key)
        for label in ([case.label] if case.label else labels)
        for axis in setup.plant.model.outputs
    ]


def _loops(setup: SetUp, case: Case, response: Response, window: Window) -> list[LoopFigures] | None:
    """Loops of the readings, axis by axis, against the one signal that is driven."""
    if case.axis is None or not isinstance(case.signal, OneFrequency) or not case.signal.periodic:
        return None
    frequency, sensor = case.signal.frequency_hz, setup.plant.instruments.sensor
    highest = 0.5 / response.sample_time_s
    if not sensor.clipped(response.reading_um):  # whose edges have harmonics without end
        highest = min(highest, sensor.bandwidth_hz)
    input_ = response.drive_v if response.reference_um is None else response.reference_um
    return loop_figures(
        input_[case.axis],
        response.reading_um,
        frequency,
        response.sample_time_s,
        window.settle_cycles,
        max(1, int(highest / frequency)),
    )


def _sensor_lag(setup: SetUp, rows: Sequence[Row]) -> list[str]:
    """Say where the reading is off because of the sensor, not because the actuator is."""
    sensor = setup.plant.instruments.sensor
    seen = [(row.rms_um or 0.0, row.rms_true_um or 0.0, row) for row in rows]  # both None without a reference
    lagging = [found for found in seen if found[0] > LAGGING * found[1]]
    if setup.scenario.reference is None or math.isinf(sensor.bandwidth_hz) or not lagging:
        return []
    reading, true, row = max(lagging, key=lambda found: found[0] - found[1])
    why = "is noisy" if reading < LAGGING * sensor.noise_um else f"of {sensor.bandwidth_hz:g} Hz lags"
    return [
        f"The sensor {why}: with {row.compensator!r}{row.at}, the rms error on {row.measured_axis} is "
        f"{length(reading)} um for its reading, but {length(true)} um for the true position. Judge a "
        "compensator by the true position."
    ]


def _far_from_home(setup: SetUp, results: Sequence[Result]) -> list[str]:
    """State where a model, or the actuator, is used at voltages that its records did not cover."""
    plant = setup.plant.model
    farthest: dict[str, tuple[float, str]] = {}
    for result in results:
        drive = result.trace.response.drive_v
        labels = [result.trace.label] if result.trace.label else list(setup.models)
        used = {label: (setup.models[label].recorded, FAR) for label in labels}
        if plant.voltages is not None:
            used[SIMULATED] = plant.voltages, FAR_ITSELF
        for label, (known, why) in used.items():
            limits = zip(plant.inputs, drive, known.lowest_v, known.highest_v, strict=True)
            for name, row, low, high in limits:
                excess = max(float(row.max()) - high, low - float(row.min()))
                if excess > max(BEYOND * (high - low), farthest.get(label, (0.0, ""))[0]):
                    went = f"the drive goes from {row.min():.4g} to {row.max():.4g} V on {name}"
                    farthest[label] = excess, f"{label}: {went}, {why.format(low=low, high=high)}"
    return [text for _, text in farthest.values()]


def _sampling(setup: SetUp) -> Iterator[str]:
    """State the error of the sample time alone, if there are two sample times, and what was not recorded."""
    scenario, step = setup.scenario, setup.plant.sample_time_s
    highest = max(signal.highest_frequency_hz for signal in scenario.signals())
    share = hold_share(highest, step)
    if share > HOLD_SHARE:
        held = (
            f"Each voltage is constant for {interval(step)}. At {highest:g} Hz this alone "
            f"causes an error of {100.0 * share:.2g} % of a sine's amplitude; the error exceeds "
            f"{100.0 * HOLD_SHARE:g} % above {HOLD_SHARE / (math.pi * step):.3g} Hz. "
        )
        yield held + (
            "Without dynamics, it occurs between the samples only; the numbers in this report are errors at "
            "the samples."
            if isinstance(setup.plant.model.dynamics, StaticDynamics)
            else "Only laws and models with dynamics correct this."
        )
    for source in (*scenario.compensators, *scenario.models):
        own = getattr(source.identification, "sample_time_s", None)
        if own is not None and not math.isclose(own, step):
            both = f"identified at a sample time of {interval(own)}, run at {interval(step)}"
            yield f"{source.label}: {both}; the model does not contain this difference."
    every = scenario.measure.record_every
    if every is not None:
        yield f"One of {every} samples was recorded, every {interval(every * step)}; numbers are from these."


def hold_share(frequency_hz: float, sample_time_s: float) -> float:
    """Error of a held sine, as a part of its amplitude.

        |1 - (1 - exp(-j w T)) / (j w T)|,   about w T / 2

    >>> round(hold_share(420.0, 50e-6), 4)
    0.0659
    """
    angle = 2.0 * math.pi * frequency_hz * sample_time_s
    return 0.0 if angle == 0.0 else abs(1.0 - (1.0 - cmath.exp(-1j * angle)) / (1j * angle))


def statements_of(setup: SetUp, results: Sequence[Result]) -> tuple[str, ...]:
    """Notes for a reader of the report: convergence, saturation, and loops that did not settle."""
    statements = [f"{label}: {text}" for label, law in setup.laws.items() if (text := law.statement())]
    plant = setup.plant.model
    off = plant.verdict.error(plant.outputs) if plant.verdict is not None else ""
    known = f" ({off}, from its fit report)" if off else ""
    statements += [
        f"{label}: {ITSELF}. On a real actuator, the model error is added{known}."
        for label in setup.laws
        if setup.models[label].digest() == plant.digest()
    ]
    statements += [  # the flags in the fit reports of the models, and of the simulated actuator
        f"{label}: {FLAGGED}: {'; '.join(model.verdict.statements) or 'see there'}."
        for label, model in {**setup.models, SIMULATED: plant}.items()
        if model.verdict is not None and model.verdict.flagged
    ]
    statements += _far_from_home(setup, results)
    statements += _sampling(setup)
    statements += _sensor_lag(setup, [row for result in results for row in result.rows])
    places = told_apart([Condition.of(result.rows[0]) for result in results])
    for result in results:
        row = result.rows[0]
        axis = "all axes" if row.excited_axis == "all" else f"axis {row.excited_axis}"
        run = row.compensator if setup.scenario.compensators else setup.plant.model.name  # models share it
        at = places[Condition.of(row)]
        where = f"{run}{f' at {at}' * bool(at)}, {axis}"
        if result.unsettled:
            statements.append(f"{where}: the position has not settled; {result.unsettled}.")
        if cut := row.saturated_samples:
            statements.append(f"{where}: the drive's range clipped {number_of(int(cut), 'sample')}.")
        if result.clipped:
            statements.append(
                f"{where}: the sensor's range clipped {result.clipped} samples of the reading; use a "
                "larger instruments.sensor.range_um, or look at the true position."
            )
    return tuple(statements)
