"""From the traces of a report to loops and errors, one input driven at a time."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.report import Report, Trace
from hammerstein.metrics.arrays import settled_cycle
from hammerstein.reporting.figures.loops import ErrorRun, LoopRun
from hammerstein.scenario.scenario import Sweep

MOST_CURVES = 6  # loops in one panel
MOST_OVERLAYS = 4  # models drawn over a loop
MOST_PHASES = 2000  # samples of a mean cycle
SWEPT_WORDS = {
    "frequency_hz": "{:g} Hz",
    "amplitude_um": "{:g} µm",
    "amplitude_v": "{:g} V",
    "radius_um": "radius {:g} µm",
    "trial": "trial {:g}",
}


def legible_parts(traces: Sequence[Trace]) -> dict[str, list[Trace]]:
    """All traces in one figure if it stays legible, otherwise one figure for each compensator; by suffix."""
    labels = list(dict.fromkeys(trace.label for trace in traces))
    curves = {(trace.label, repr(trace.signal), trace.trial) for trace in traces}
    if len(curves) <= MOST_CURVES or len(labels) == 1:
        return {"": list(traces)}
    return {
        f"_{number}_{slug(label)}": [trace for trace in traces if trace.label == label]
        for number, label in enumerate(labels, start=1)
    }


def slug(label: str) -> str:
    """Part of a file name.

    >>> slug("paper's law, 50 Hz")
    'paper_s_law_50_hz'
    """
    return re.sub(r"[^a-z0-9]+", "_", label.lower()).strip("_")[:40]


def swept_label(trace: Trace, sweep: Sweep) -> str:
    """Values of the sweep in one trace, as in ``50 Hz, 10 V``; empty without a sweep."""
    values = trace.signal.model_dump() | {"trial": trace.trial}
    swept = {key: word for key, word in SWEPT_WORDS.items() if len(getattr(sweep, key) or ()) > 1}
    return ", ".join(word.format(values[key]) for key, word in swept.items())


def legend_labels(report: Report, traces: Sequence[Trace]) -> list[str]:
    """Text of the legend for each trace: only what distinguishes the curves of one figure."""
    compared = len({trace.label for trace in traces}) > 1
    labels = []
    for trace in traces:
        value = swept_label(trace, report.scenario.sweep)
        name = trace.label if compared or not value else ""
        told = value and re.search(rf"(?<![\d.]){re.escape(value)}\b", name)
        labels.append(", ".join(word for word in (name, "" if told else value) if word))
    return labels


def loop_runs(report: Report, traces: Sequence[Trace], true: bool = False) -> list[LoopRun]:
    """Mean measured cycle of each trace, reading or true position, and the predictions of the models."""
    labels = legend_labels(report, traces)
    return [
        loop_of(trace, label or f"{trace.signal.highest_frequency_hz:g} Hz", driven_of(report, trace), true)
        for trace, label in zip(traces, labels, strict=True)
    ]


def error_runs(report: Report, traces: Sequence[Trace]) -> list[ErrorRun]:
    """First measured cycle of the errors of each trace; none for a run in volts without models."""
    labels = legend_labels(report, traces)
    return [
        error
        for trace, label in zip(traces, labels, strict=True)
        for error in errors_of(trace, label, driven_of(report, trace))
    ]


def driven_of(report: Report, trace: Trace) -> int:
    """Number of the input that a trace excites: named by the trace, or by its signal."""
    names = report.inputs if report.scenario.drive is not None else report.axes
    if trace.excited_axis in names:
        return names.index(trace.excited_axis)
    return int(trace.signal.model_dump()["axis"]) - 1


def loop_of(trace: Trace, label: str, driven: int, true: bool = False) -> LoopRun:
    """Mean measured cycle of a trace, and the predictions of a few models."""
    response = trace.response
    wire = response.drive_v if response.reference_um is None else response.reference_um
    shown = trace.predictions if len(trace.predictions) <= MOST_OVERLAYS else ()
    measured = response.position_um if true else response.reading_um
    outputs = [measured, *(p.reading_um for p in shown)]
    cycle = _closed_cycle(trace, np.vstack([wire[driven], *outputs]))
    means = np.split(cycle[1:], len(outputs))
    predictions = tuple((p.label, mean) for p, mean in zip(shown, means[1:], strict=True))
    return LoopRun(label, driven, cycle[0], means[0], predictions)


def _closed_cycle(trace: Trace, signals: Array) -> Array:
    """Mean of the measured cycles (signal, sample), its first sample repeated at its end."""
    period, sample_time_s = trace.signal.period_s, trace.response.sample_time_s
    samples = round(period / sample_time_s)
    if signals.shape[1] * sample_time_s < period * (1.0 + 1e-9):
        return signals
    cycle = settled_cycle(signals, 1.0 / period, sample_time_s, min(MOST_PHASES, samples))
    return np.hstack([cycle, cycle[:, :1]])


def errors_of(trace: Trace, label: str, driven: int) -> Iterator[ErrorRun]:
    """First measured cycle of the errors of a trace: of the true position, or of each prediction."""
    response, period = trace.response, trace.signal.period_s
    first = slice(0, round(period / response.sample_time_s) + 1)
    errors = [(p.label, response.reading_um - p.reading_um) for p in trace.predictions]
    if response.reference_um is not None:
        errors = [("", response.position_um - response.reference_um)]
    for name, error_um in errors:
        worst_um = float(np.abs(error_um).max())
        words = ", ".join(word for word in (name, label) if word)
        yield ErrorRun(words, driven, response.time_s[first] / period, error_um[:, first], worst_um)
