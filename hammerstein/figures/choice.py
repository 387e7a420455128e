"""Which figures answer a scenario, and with which of its traces."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.figures.loops import ErrorRun, LoopRun, errors_figure, loops_figure
from hammerstein.figures.path import PathRun, path_errors_figure, path_figure
from hammerstein.figures.style import Array, symbol
from hammerstein.figures.sweep import SweepCurve, sweep_figure
from hammerstein.report import Report, Row, Trace
from hammerstein.scenario import Sweep
from hammerstein.signals import Excitation, OnAxes, Reference

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_LOOPS = 4  # frequencies of a run that are drawn as loops; more make a curve over frequency
MOST_CURVES = 6  # loops in one panel
MOST_PHASES = 2000  # samples of a mean cycle
SWEPT_WORDS = {
    "frequency_hz": "{:g} Hz",
    "amplitude_um": "{:g} µm",
    "amplitude_v": "{:g} V",
    "radius_um": "radius {:g} µm",
}


def figures_of(report: Report) -> dict[str, Figure]:
    """Figures that answer a scenario, by name.

    Few values of one signal on each axis in turn give loops and errors over the cycle; more than four
    frequencies give curves over frequency; everything else is drawn as a path.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run``, with its traces

    Examples
    --------
    >>> from hammerstein.experiment import run
    >>> from hammerstein.scenario import Scenario
    >>> scenario = Scenario.model_validate({
    ...     "question": "How large is a loop?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}})
    >>> list(figures_of(run(scenario)))
    ['loops']
    """
    if len({row.frequency_hz for row in report.rows}) > MOST_LOOPS:
        return _sweeps(report)
    if not report.traces:
        return {}
    signal = report.scenario.signal
    if isinstance(signal, OnAxes) and signal.axis != "all":
        return _loops(report)
    return _paths(report)


def _sweeps(report: Report) -> dict[str, Figure]:
    """Error of the reading and, for a compensator, of the true position; without a target the gain."""
    names = ["rms_um"] if any(row.rms_um is not None for row in report.rows) else ["gain"]
    if report.scenario.reference is not None:
        names.append("rms_true_um")
    figures = {}
    for name in names:
        suffix, quantity, title = SWEPT[name]
        if name == "rms_um" and report.scenario.drive is not None:
            title = "Error of the models, seen by the sensor"
        curves = sweep_curves(report, name)
        titles = _transfers(report)
        figures[f"sweep{suffix}"] = sweep_figure(curves, titles, quantity, title)
    return figures


SWEPT = {
    "rms_um": ("", "rms error [µm]", "Error of the sensor's reading"),
    "rms_true_um": ("_true", "rms error [µm]", "Error of the true position"),
    "gain": ("", "gain [µm/V]", "Gain of the first harmonic"),
}


def _excited(report: Report) -> list[str]:
    return list(dict.fromkeys(row.excited_axis for row in report.rows))


def _transfers(report: Report) -> list[list[str]]:
    """What stands above each panel (output, excited axis) of a sweep."""
    role = "voltage" if report.scenario.drive is not None else "reference"
    return [
        [
            f"{symbol(measured, 'reading')}, all axes driven"
            if excited == "all"
            else f"{symbol(excited, role)} to {symbol(measured, 'reading')}"
            + (", direct" if k == o else ", cross-coupling")
            for k, excited in enumerate(_excited(report))
        ]
        for o, measured in enumerate(report.axes)
    ]


def sweep_curves(report: Report, name: str) -> list[SweepCurve]:
    """One figure of merit against frequency, a curve for each compensator or model (and amplitude)."""
    identified = identified_at(report)
    curves = []
    amplitudes = {(row.amplitude_v, row.amplitude_um) for row in report.rows}
    by_curve: dict[str, list[Row]] = {}
    for row in report.rows:
        size = f"{row.amplitude_um:g} µm" if row.amplitude_um is not None else f"{row.amplitude_v or 0:g} V"
        words = [row.compensator or "actuator", *([size] if len(amplitudes) > 1 else [])]
        by_curve.setdefault(", ".join(words), []).append(row)
    for label, rows in by_curve.items():
        frequencies = sorted({row.frequency_hz for row in rows})
        values = np.full((len(report.axes), len(_excited(report)), len(frequencies)), np.nan)
        for row in rows:
            place = (
                report.axes.index(row.measured_axis),
                _excited(report).index(row.excited_axis),
                frequencies.index(row.frequency_hz),
            )
            value = getattr(row, name)
            values[place] = np.nan if value is None else value
        curves.append(SweepCurve(label, np.array(frequencies), values, identified.get(rows[0].compensator)))
    return curves


def identified_at(report: Report) -> dict[str, float]:
    """Frequency at which each compensator's or model's hysteresis was identified, where there is one."""
    sources = (*report.scenario.compensators, *report.scenario.models)
    found = {source.label: getattr(source.identification, "frequency_hz", None) for source in sources}
    return {label: frequency for label, frequency in found.items() if frequency is not None}


def swept_label(signal: Reference | Excitation, sweep: Sweep) -> str:
    """The values of the sweep in one signal, as in ``50 Hz, 10 V``; empty without a sweep."""
    values = signal.model_dump()
    swept = {key: word for key, word in SWEPT_WORDS.items() if len(getattr(sweep, key) or ()) > 1}
    return ", ".join(word.format(values[key]) for key, word in swept.items())


def _loops(report: Report) -> dict[str, Figure]:
    figures: dict[str, Figure] = {}
    for suffix, traces in _readable(report.traces):
        labels = _labels(report, traces)
        volts = report.scenario.drive is not None
        driven = [_driven(report, trace) for trace in traces]
        columns = sorted(set(driven))
        names = report.inputs if volts else report.axes
        role, unit = ("voltage", "V") if volts else ("reference", "µm")
        inputs = [f"{symbol(names[k], role)} [{unit}]" for k in columns]
        loops = [
            _loop(trace, label, columns.index(k), k)
            for trace, label, k in zip(traces, labels, driven, strict=True)
        ]
        outputs = [f"{symbol(name, 'reading')} [µm]" for name in report.axes]
        title = "Sensor's reading over the voltage" if volts else "Sensor's reading over the reference"
        figures[f"loops{suffix}"] = loops_figure(loops, inputs, outputs, title)
        errors = [
            error
            for trace, label, k in zip(traces, labels, driven, strict=True)
            for error in _errors(trace, label, columns.index(k))
        ]
        if errors:
            figures[f"errors{suffix}"] = errors_figure(
                errors,
                [symbol(names[k], role) for k in columns],
                [f"{symbol(name, 'error')} [µm]" for name in report.axes],
                "Reading less prediction" if volts else "Reading less reference",
            )
    return figures


def _readable(traces: Sequence[Trace]) -> Iterator[tuple[str, list[Trace]]]:
    """All traces in one figure if it stays legible, otherwise one figure for each compensator."""
    runs = {(trace.label, repr(trace.signal)) for trace in traces}
    labels = list(dict.fromkeys(trace.label for trace in traces))
    if len(runs) <= MOST_CURVES or len(labels) == 1:
        yield "", list(traces)
        return
    for number, label in enumerate(labels, start=1):
        yield f"_{number}_{slug(label)}", [trace for trace in traces if trace.label == label]


def slug(label: str) -> str:
    """Part of a file name.

    >>> slug("paper's law, 50 Hz")
    'paper_s_law_50_hz'
    """
    return re.sub(r"[^a-z0-9]+", "_", label.lower()).strip("_")[:40]


def _labels(report: Report, traces: Sequence[Trace]) -> list[str]:
    """Text of the legend: only what tells the curves of this figure apart."""
    labels = [trace.label for trace in traces]
    values = [swept_label(trace.signal, report.scenario.sweep) for trace in traces]
    several = len(set(labels)) > 1
    if several and len(set(zip(labels, values, strict=True))) == len(set(labels)):
        same = [str(label) for label in labels]
        return [
            f"{label}, {value} driven" if value and value not in label else label
            for label, value in zip(same, values, strict=True)
        ]
    words = [[label] * several + [value] * bool(value) for label, value in zip(labels, values, strict=True)]
    return [", ".join(word) or trace.label or "reading" for word, trace in zip(words, traces, strict=True)]


def _driven(report: Report, trace: Trace) -> int:
    """Number of the input that a trace excites."""
    if trace.excited_axis == "all":
        axis = getattr(trace.signal, "axis", 1)
        return int(axis) - 1
    names = report.inputs if report.scenario.drive is not None else report.axes
    return names.index(trace.excited_axis)


def _loop(trace: Trace, label: str, column: int, driven: int) -> LoopRun:
    response = trace.response
    wire = response.drive_v if response.reference_um is None else response.reference_um
    outputs = [response.reading_um, *(p.reading_um for p in trace.predictions)]
    cycle = _closed_cycle(trace, np.vstack([wire[driven], *outputs]))
    outputs_um = np.split(cycle[1:], len(outputs))
    predictions = tuple((p.label, y) for p, y in zip(trace.predictions, outputs_um[1:], strict=True))
    return LoopRun(label, column, cycle[0], outputs_um[0], predictions)


def _closed_cycle(trace: Trace, signals: Array) -> Array:
    """Mean of the measured cycles (signal, sample), its first sample repeated at the end."""
    sample_time_s, frequency_hz = trace.response.sample_time_s, 1.0 / trace.signal.period_s
    phases = min(MOST_PHASES, round(trace.signal.period_s / sample_time_s))
    if signals.shape[1] * sample_time_s * frequency_hz < 1.0 + 1e-9:
        return signals[:, : round(trace.signal.period_s / sample_time_s) + 1]
    cycle = settled_cycle(signals, frequency_hz, sample_time_s, phases)
    return np.hstack([cycle, cycle[:, :1]])


def _errors(trace: Trace, label: str, column: int) -> Iterator[ErrorRun]:
    response = trace.response
    first = slice(0, round(trace.signal.period_s / response.sample_time_s) + 1)
    cycles = response.time_s[first] / trace.signal.period_s
    targets: list[tuple[str, Array]] = [(p.label, p.reading_um) for p in trace.predictions]
    if response.reference_um is not None:
        targets = [("", response.reference_um)]
    for name, target_um in targets:
        error_um = response.reading_um - target_um
        words = ", ".join(word for word in (name, label) if word)
        yield ErrorRun(words, column, cycles, error_um[:, first], float(np.abs(error_um).max()))


def _paths(report: Report) -> dict[str, Figure]:
    runs = list(itertools.chain.from_iterable(_path_runs(report, trace) for trace in report.traces))
    volts = report.scenario.drive is not None
    target, title = ("measured", "Prediction of the models") if volts else ("reference", "Sensor's reading")
    if runs[0].target_um is None:
        title = "Sensor's reading"
    figures = {"path": path_figure(runs, report.axes, target, title)}
    if len({run.group for run in runs}) > 1 and runs[0].target_um is not None:
        figures["errors"] = path_errors_figure(runs, report.axes, title)
    return figures


def _path_runs(report: Report, trace: Trace) -> Iterator[PathRun]:
    """A compensator's reading against its reference, or each model's prediction against the reading."""
    response, signal = trace.response, trace.signal
    group = swept_label(signal, report.scenario.sweep)
    length = float(trace.time_s[-1] - trace.time_s[0])
    shown = min(length, 2.0 * signal.period_s) if signal.repeats else length
    if response.reference_um is not None:
        yield PathRun(trace.label, group, trace.time_s, response.reference_um, response.reading_um, shown)
        return
    for p in trace.predictions:
        yield PathRun(p.label, group, trace.time_s, response.reading_um, p.reading_um, shown)
    if not trace.predictions:
        yield PathRun("reading", group, trace.time_s, None, response.reading_um, shown)
