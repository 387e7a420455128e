"""From a response to the rows of a report."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hammerstein.dynamics import StaticDynamics, discretise
from hammerstein.experiment.prepare import Case, SetUp, Window, scenario_axes
from hammerstein.experiment.report import Prediction, Trace
from hammerstein.metrics import METRICS, LoopFigures, Measured, Metric, Row, loop_figures
from hammerstein.model import HammersteinModel
from hammerstein.signals import OneFrequency
from hammerstein.simulation import Response

Array = NDArray[np.float64]

LAGGING = 2.0  # reading against true position: from here on most of the error is the sensor's
SETTLED_FRACTION = 1e-3  # cycles may differ by this part of the range, beside the sensor's noise


@dataclass(frozen=True, eq=False)
class Result:
    """Rows of one case, its measured trace, and whether it had settled."""

    rows: tuple[Row, ...]
    trace: Trace
    settled: bool


@dataclass(frozen=True, eq=False)
class Target:
    """What a position (axis, sample) is compared with: a reference, or the prediction of a model."""

    label: str
    reading_um: Array
    position_um: Array


def rows_of(setup: SetUp, case: Case) -> Result:
    """Simulate one case and measure it."""
    response = setup.simulate(case)
    window = Window.of(setup.scenario, case.signal, setup.plant.sample_time_s)
    targets = _targets(setup, case, response)
    loops = _loops(setup, case, response, window)
    rows = tuple(_rows(setup, case, response, targets, METRICS.values(), loops))
    names = scenario_axes(setup.scenario, setup.plant.model)
    predictions = tuple(
        Prediction(t.label, t.reading_um[:, window.first :], t.position_um[:, window.first :])
        for t in targets
        if t is not None and setup.scenario.drive is not None
    )
    trace = Trace(
        label=case.label,
        signal=case.signal,
        excited_axis="all" if case.axis is None else names[case.axis],
        response=response.after(window.first),
        first_sample=window.first,
        predictions=predictions,
    )
    return Result(rows, trace, _settled(setup, case, response, window))


def drawn_rows(setup: SetUp, case: Case, response: Response) -> tuple[Row, ...]:
    """Rows of one case with the figures alone of which an uncertain actuator gives a band."""
    drawn = [metric for metric in METRICS.values() if metric.drawn]
    return tuple(_rows(setup, case, response, _targets(setup, case, response), drawn))


def _rows(
    setup: SetUp,
    case: Case,
    response: Response,
    targets: Sequence[Target | None],
    wanted: Iterable[Metric],
    loops: Sequence[LoopFigures] | None = None,
) -> Iterator[Row]:
    """Rows target by target, within each of them axis by axis."""
    first = Window.of(setup.scenario, case.signal, setup.plant.sample_time_s).first
    axes, key, wanted = setup.plant.model.outputs, _key(setup, case), list(wanted)
    run = response.after(first)
    for target in targets:
        measured = Measured(
            run.sample_time_s,
            run.reading_um,
            run.position_um,
            run.saturated,
            None if target is None else target.reading_um[:, first:],
            None if target is None else target.position_um[:, first:],
            run.reference_um if case.axis is None else None,
            _whole_cycle(setup, case),
            loops,
        )
        label = case.label if target is None else target.label
        found = {metric.name: metric.values(measured) for metric in wanted}
        for i, axis in enumerate(axes):
            figures = {name: value for name, values in found.items() if (value := values[i]) is not None}
            yield Row(compensator=label, measured_axis=axis, **key, figures=figures)


def _targets(setup: SetUp, case: Case, response: Response) -> list[Target] | list[None]:
    """What the response is compared with; a single None where there is nothing."""
    if response.reference_um is not None:
        return [Target(case.label, response.reference_um, response.reference_um)]
    models = [
        Target(source.label, *_prediction(setup, setup.models[source.label], response))
        for source in setup.scenario.models
        if source.is_tested_at(case.signal.highest_frequency_hz)
    ]
    return models or [None]


def _prediction(setup: SetUp, model: HammersteinModel, response: Response) -> tuple[Array, Array]:
    """What a model says the sensor reads, and where it says the actuator is."""
    v, _ = model.static_response(response.drive_v)
    if isinstance(model.dynamics, StaticDynamics):
        return v, v  # a static model was found from readings: it stands for both
    sensor = setup.plant.instruments.sensor
    block = discretise(model.dynamics, setup.plant.sample_time_s, sensor.bandwidth_hz)
    position, reading = np.split(block.respond(v)[0], 2)
    return reading, position


def _key(setup: SetUp, case: Case) -> dict[str, Any]:
    """What tells the rows of a case from those of others, whatever the response is compared with."""
    names = scenario_axes(setup.scenario, setup.plant.model)
    signal = case.signal.model_dump()
    return {
        "excited_axis": "all" if case.axis is None else names[case.axis],
        "frequency_hz": case.signal.highest_frequency_hz,
        "amplitude_v": signal.get("amplitude_v", signal.get("radius_v")),
        "amplitude_um": signal.get("amplitude_um", signal.get("radius_um")),
    }


def _whole_cycle(setup: SetUp, case: Case) -> int | None:
    """Samples of a cycle, where several equal ones of a whole number of samples are measured."""
    samples = case.signal.period_s / setup.plant.sample_time_s
    whole = abs(samples - round(samples)) < 1e-6
    several = case.signal.repeats and setup.scenario.measure.measured_cycles > 1
    return round(samples) if whole and several else None


def _loops(setup: SetUp, case: Case, response: Response, window: Window) -> list[LoopFigures] | None:
    """Loops of the readings, axis by axis, against the one signal that is driven."""
    if case.axis is None or not isinstance(case.signal, OneFrequency) or not case.signal.periodic:
        return None
    frequency, sensor = case.signal.frequency_hz, setup.plant.instruments.sensor
    nyquist = 0.5 / response.sample_time_s
    input_ = response.drive_v if response.reference_um is None else response.reference_um
    return loop_figures(
        input_[case.axis],
        response.reading_um,
        frequency,
        response.sample_time_s,
        window.settle_cycles,
        max(1, int(min(sensor.bandwidth_hz, nyquist) / frequency)),
    )


def _settled(setup: SetUp, case: Case, response: Response, window: Window) -> bool:
    """Whether the first and the last measured cycle of the true position agree."""
    cycles = setup.scenario.measure.measured_cycles
    if not isinstance(case.signal, OneFrequency) or not case.signal.repeats or cycles < 2:
        return True
    position = response.position_um
    length = int(case.signal.period_s / response.sample_time_s)
    lag = round((cycles - 1) * case.signal.period_s / response.sample_time_s)
    first = position[:, window.first : window.first + length]
    last = position[:, window.first + lag : window.first + lag + length]
    fraction = abs(lag * response.sample_time_s / case.signal.period_s - (cycles - 1))
    allowed = (SETTLED_FRACTION + 2.0 * np.pi * fraction) * float(np.ptp(position))
    return float(np.abs(first[:, : last.shape[1]] - last).max()) <= allowed + 1e-9


def _sensor_lag(setup: SetUp, rows: Sequence[Row]) -> list[str]:
    """Say where the reading is off because the sensor lags, not because the actuator is."""
    bandwidth = setup.plant.instruments.sensor.bandwidth_hz
    seen = [(row.rms_um, row.rms_true_um, row) for row in rows if setup.scenario.reference is not None]
    lagging = [
        (reading, true, row)
        for reading, true, row in seen
        if reading is not None and true is not None and reading > LAGGING * true
    ]
    if math.isinf(bandwidth) or not lagging:
        return []
    reading, true, row = max(lagging, key=lambda found: found[0] - found[1])
    return [
        f"The sensor of {bandwidth:g} Hz lags: with {row.compensator!r} at {row.frequency_hz:g} Hz its "
        f"reading on {row.measured_axis} is {reading:.3g} um rms off the reference, the true position "
        f"{true:.3g} um. "
        "A compensator is to be judged by the true position."
    ]


def statements_of(setup: SetUp, results: Sequence[Result]) -> tuple[str, ...]:
    """What a reader of the report must know: convergence, saturation, and what did not settle."""
    statements = [f"{label}: {text}" for label, law in setup.laws.items() if (text := law.statement())]
    statements += [
        f"{label}: its model is the simulated actuator itself. On a real one the model's error comes on top."
        for label in setup.laws
        if setup.models[label].digest() == setup.plant.model.digest()
    ]
    statements += _sensor_lag(setup, [row for result in results for row in result.rows])
    for result in results:
        row = result.rows[0]
        where = (
            f"{row.compensator or setup.plant.model.name} at {row.frequency_hz:g} Hz, axis {row.excited_axis}"
        )
        if not result.settled:
            statements.append(f"{where}: the loop has not settled; wait longer (measure.settle_cycles).")
        if row.saturated_samples:
            statements.append(f"{where}: the drive's range cut {row.saturated_samples} samples.")
    return tuple(statements)
