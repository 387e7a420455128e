"""From a response to the rows of a report."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import SimulationError
from hammerstein.experiment.recording import advice, recorded, settled, targets_of
from hammerstein.experiment.report import Target, Trace
from hammerstein.experiment.set_up import Case, SetUp, Window
from hammerstein.metrics import LoopFigures, Measured, Metric, Row, loop_figures, metrics_of
from hammerstein.model.simulation import Response
from hammerstein.signals import OneFrequency

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


@dataclass(frozen=True, eq=False)
class Result:
    """Rows of one case, its measured trace, what to do if it had not settled, and samples that are cut.

    unsettled : empty if it had; clipped : samples at the sensor's range
    """

    rows: tuple[Row, ...]
    trace: Trace
    unsettled: str
    clipped: int


def rows_of(setup: SetUp, case: Case) -> Result:
    """Simulate one case and measure it."""
    recording = recorded(setup, case)
    response, targets = recording.response, recording.targets
    _refuse_still(setup, case, response)
    window = Window.of(setup.scenario, case.signal, response.sample_time_s)
    loops = _loops(setup, case, response, window)
    rows = tuple(_rows(setup, case, response, targets, setup.scenario.metrics(), loops))
    predictions = tuple(
        target.part(slice(window.first, None))
        for target in targets
        if target is not None and setup.scenario.drive is not None
    )
    trace = Trace(
        label=case.label,
        signal=case.signal,
        excited_axis=setup.excited_axis(case),
        response=response.after(window.first),
        first_sample=window.first,
        predictions=predictions,
        trial=case.trial,
    )
    unsettled = "" if settled(setup, case, response) else advice(setup, case)
    clipped = setup.plant.instruments.sensor.clipped(response.reading_um[:, window.first :])
    return Result(rows, trace, unsettled, clipped)


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
    """Rows of one case with the figures alone of which an uncertain actuator gives a band."""
    drawn = [metric for metric in metrics_of() if metric.drawn]
    return tuple(_rows(setup, case, response, targets_of(setup, case, response)[0], drawn))


def _rows(
    setup: SetUp,
    case: Case,
    response: Response,
    targets: Sequence[Target | None],
    wanted: Iterable[Metric],
    loops: Sequence[LoopFigures] | None = None,
) -> Iterator[Row]:
    """Rows target by target, within each of them axis by axis."""
    first = Window.of(setup.scenario, case.signal, response.sample_time_s).first
    axes, key, wanted = setup.plant.model.outputs, _key(setup, case), list(wanted)
    path = response.reference_um if case.axis is None else None
    for target in targets:
        measured = Measured(
            response.sample_time_s,
            response.reading_um[:, first:],
            response.position_um[:, first:],
            response.saturated[:, first:],
            None if target is None else target.reading_um[:, first:],
            None if target is None else target.position_um[:, first:],
            None if path is None else path[:, first:],
            _whole_cycle(setup, case, response.sample_time_s),
            loops,
            _middle(case, response),
        )
        label = case.label if target is None else target.label
        found = {metric.name: metric.values(measured) for metric in wanted}
        for i, axis in enumerate(axes):
            figures = {name: value for name, values in found.items() if (value := values[i]) is not None}
            yield Row(compensator=label, measured_axis=axis, **key, figures=figures)


def _middle(case: Case, response: Response) -> Array | None:
    """Middle (output,) of a path of all axes together [um]."""
    if response.reference_um is None or case.axis is not None:
        return None
    outputs = len(response.reference_um)
    return case.signal.middle(outputs, np.zeros(outputs))


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
    """The rows that a case will give, as yet without figures."""
    labels = [source.label for source in setup.scenario.models] or [""]
    key = _key(setup, case)
    return [
        Row(compensator=label, measured_axis=axis, **key)
        for label in ([case.label] if case.label else labels)
        for axis in setup.plant.model.outputs
    ]


def _whole_cycle(setup: SetUp, case: Case, sample_time_s: float) -> int | None:
    """Samples of a cycle, where several equal ones of a whole number of samples are measured."""
    samples = case.signal.period_s / sample_time_s
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


def _sensor_lag(setup: SetUp, rows: Sequence[Row]) -> list[str]:
    """Say where the reading is off because of the sensor, not because the actuator is."""
    sensor = setup.plant.instruments.sensor
    seen = [(row.rms_um, row.rms_true_um, row) for row in rows if setup.scenario.reference is not None]
    lagging = [
        (reading, true, row)
        for reading, true, row in seen
        if reading is not None and true is not None and reading > LAGGING * true
    ]
    if math.isinf(sensor.bandwidth_hz) or not lagging:
        return []
    reading, true, row = max(lagging, key=lambda found: found[0] - found[1])
    why = "is noisy" if reading < LAGGING * sensor.noise_um else f"of {sensor.bandwidth_hz:g} Hz lags"
    return [
        f"The sensor {why}: with {row.compensator!r}{row.at}, the rms error on {row.measured_axis} is "
        f"{reading:.3g} um for its reading, but {true:.3g} um for the true position. Judge a "
        "compensator by the true position."
    ]


def _flagged(setup: SetUp) -> list[str]:
    """State the flags in the fit reports of the models, and of the simulated actuator."""
    models = {**setup.models, SIMULATED: setup.plant.model}
    verdicts = {label: model.verdict for label, model in models.items()}
    return [
        f"{label}: {FLAGGED}: {'; '.join(verdict.statements) or 'see there'}."
        for label, verdict in verdicts.items()
        if verdict is not None and verdict.flagged
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
            for name, row, low, high in zip(
                plant.inputs, drive, known.lowest_v, known.highest_v, strict=True
            ):
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
            f"Each voltage is constant for {1e6 * step:g} us. At {highest:g} Hz this alone "
            f"causes an error of {100.0 * share:.2g} % of a sine's amplitude; the error exceeds "
            f"{100.0 * HOLD_SHARE:g} % above {HOLD_SHARE / (math.pi * step):.3g} Hz. "
        )
        if isinstance(setup.plant.model.dynamics, StaticDynamics):
            yield held + (
                "Without dynamics, this error occurs between the samples only; the numbers "
                "in this report are errors at the samples."
            )
        else:
            yield held + "Only a law or a model with dynamics accounts for it."
    for source in (*scenario.compensators, *scenario.models):
        own = getattr(source.identification, "sample_time_s", None)
        if own is not None and not math.isclose(own, step):
            yield (
                f"{source.label}: identified at a sample time of {1e6 * own:g} us, run at "
                f"{1e6 * step:g} us; the model does not contain this difference."
            )
    every = scenario.measure.record_every
    if every is not None:
        yield (
            f"One of {every} samples was recorded, one every {1e3 * every * step:g} ms; all "
            "numbers are from these samples."
        )


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
    statements += _flagged(setup)
    statements += _far_from_home(setup, results)
    statements += _sampling(setup)
    statements += _sensor_lag(setup, [row for result in results for row in result.rows])
    for result in results:
        row = result.rows[0]
        axis = "all axes" if row.excited_axis == "all" else f"axis {row.excited_axis}"
        run = row.compensator if setup.scenario.compensators else setup.plant.model.name  # models share it
        where = f"{run}{row.at}, {axis}"
        if result.unsettled:
            statements.append(f"{where}: the loop has not settled; {result.unsettled}.")
        if cut := row.saturated_samples:
            statements.append(f"{where}: the drive's range cut {cut} sample{'s' * (cut != 1)}.")
        if result.clipped:
            statements.append(
                f"{where}: the sensor's range cut {result.clipped} samples of the reading; use a "
                "larger instruments.sensor.range_um, or look at the true position."
            )
    return tuple(statements)
