"""Selection of figures for a scenario."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.report import Condition, Report, Trace, told_apart
from hammerstein.metrics import Row, settled_cycle
from hammerstein.quantities import by_key
from hammerstein.reporting.figures.loops import ErrorRun, LoopRun, errors_figure, loops_figure
from hammerstein.reporting.figures.path import PathRun, path_errors_figure, path_figure
from hammerstein.reporting.figures.style import Role, plain, symbol
from hammerstein.reporting.figures.sweep import (
    DriftRun,
    SweepCurve,
    drift_figure,
    sensitivity_figure,
    sweep_figure,
)
from hammerstein.scenario.scenario import Sweep
from hammerstein.signals import OnAxes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_CURVES = 4  # loops, or errors over the cycle, in one panel
MOST_OVERLAYS = 4  # models drawn over a loop
MOST_PHASES = 2000  # samples of a mean cycle
SWEPT_WORDS = {
    "frequency_hz": "{:g} Hz",
    "amplitude_um": "{:g} µm",
    "amplitude_v": "{:g} V",
    "radius_um": "radius {:g} µm",
    "trial": "trial {:g}",
}
MOST_LOOPS = 4  # frequencies of a run that are drawn as loops; more make a curve over frequency
DRIFT = "drift_true_um"
MOST_SHOWN_VALUES = 12  # values of a sweep at which loops and paths can be looked at


class Over(NamedTuple):
    """Abscissa of the curves of a report.

    key : of a row; words : label of the axis; figure : how the files of its figures begin
    """

    key: str
    words: str
    figure: str

    def of(self, row: Row) -> float:
        """Value of a row."""
        return float(getattr(row, self.key) or 0.0)


FREQUENCY = Over("frequency_hz", "frequency [Hz]", "sweep")
TRIAL = Over("trial", "trial", "trials")


def swept_over(report: Report, most: int) -> Over | None:
    """Trials if there are several, else frequencies if there are enough; None for single runs."""
    if len({row.trial for row in report.rows}) > 1:
        return TRIAL
    return FREQUENCY if len({row.frequency_hz for row in report.rows}) > most else None


def figures_of(report: Report) -> dict[str, Figure]:
    """Figures of a scenario, by name.

    Few values of one signal on each axis in turn give loops and errors over the cycle; more than four
    frequencies give curves over frequency, trials curves over them; everything else is drawn as a path.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``, with its traces

    Examples
    --------
    >>> from hammerstein.experiment.run import run
    >>> from hammerstein.scenario.scenario import Scenario
    >>> scenario = Scenario.model_validate({
    ...     "question": "How large is a loop?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}})
    >>> list(figures_of(run(scenario)))
    ['loops']
    """
    return _answers(report) | _sensitivity(report)


def _answers(report: Report) -> dict[str, Figure]:
    over = swept_over(report, MOST_LOOPS)
    if over is not None:
        return _sweeps(report, over)
    if not report.traces:
        return {}
    if report.scenario.answered_by == DRIFT:
        return _drift(report)
    return _traced(report) | _operators(report)


def _traced(report: Report, whole: bool = False) -> dict[str, Figure]:
    """Paths, or loops and errors; all compensators in one figure, or only as many as stay legible."""
    signal = report.scenario.signal
    return _loops(report, whole) if isinstance(signal, OnAxes) and signal.axis != "all" else _paths(report)


def explored_figures(report: Report) -> tuple[dict[str, Figure], dict[str, dict[str, Figure]]]:
    """Interactive figures by name: curves over the sweep, and loops or paths at each swept value."""
    over = swept_over(report, 2)
    groups = by_key(report.traces, lambda trace: swept_label(trace, report.scenario.sweep))
    names = list(groups)
    if len(names) > MOST_SHOWN_VALUES:
        names = [
            names[round(i * (len(names) - 1) / (MOST_SHOWN_VALUES - 1))] for i in range(MOST_SHOWN_VALUES)
        ]
    one = replace(report, scenario=report.scenario.model_copy(update={"sweep": Sweep()}))
    steps = {name: _traced(replace(one, traces=tuple(groups[name])), whole=True) for name in names}
    return {} if over is None else _sweeps(report, over), steps


def _sensitivity(report: Report) -> dict[str, Figure]:
    """What the spread of each compensator is due to, in the row where it is worst."""
    metric, words = report.banded_metric
    own = [found for found in report.sensitivities if found.metric == metric]
    known_bands = [band for band in report.bands if band.metric == metric]
    bars, names = dict[str, tuple[Array, Array]](), list[str]()
    for label, bands in by_key(known_bands, lambda band: band.compensator).items():
        band = max(bands, key=lambda band: band.p95_um)
        found = [one for one in own if one.place == band.place]
        if found:
            known = np.array([[1.0 if one.is_estimated else np.nan] for one in found])
            first = known * [(one.first, one.first_low, one.first_high) for one in found]
            total = known * [(one.total, one.total_low, one.total_high) for one in found]
            names = [plain(one.parameter) for one in found]
            bars[f"{plain(label)}, {band.frequency_hz:g} Hz, {plain(band.measured_axis)}"] = first, total
    title = f"Causes of the spread of the {words} of the true position"
    return {"sensitivity": sensitivity_figure(names, bars, title)} if bars else {}


def _drift(report: Report) -> dict[str, Figure]:
    """Mean error of each measured cycle over time, of the axes that are driven themselves."""
    runs = []
    for trace in report.traces:
        response, signal = trace.response, trace.signal
        samples = round(signal.period_s / response.sample_time_s)
        if response.reference_um is None or trace.excited_axis not in report.axes:
            continue
        axis = report.axes.index(trace.excited_axis)
        error = response.position_um[axis] - response.reference_um[axis]
        cycles = len(error) // samples
        means = error[: cycles * samples].reshape(cycles, samples).mean(axis=1)
        middles_s = trace.time_s[0] + (np.arange(cycles) + 0.5) * signal.period_s
        runs.append(DriftRun(trace.label, axis, middles_s, means))
    if not runs:
        return {}
    return {"drift": drift_figure(runs, [symbol(name, "reading") for name in report.axes])}


def _loops(report: Report, whole: bool) -> dict[str, Figure]:
    volts = report.scenario.drive is not None
    role, unit = _driven_quantity(report)
    driven = [symbol(name, role) for name in (report.inputs if volts else report.axes)]
    inputs = [f"{role} {name} [{unit}]" for name in driven]
    true, quantity = _shown_quantity(report)
    outputs = [f"{quantity.split()[-1]} {symbol(name, 'reading')} [µm]" for name in report.axes]
    errors_of = [f"{symbol(name, 'error')} [µm]" for name in report.axes]
    wrong = "sensor's reading minus prediction" if volts else "error of the true position"
    cycles = report.scenario.measure.measured_cycles
    mean = f", {cycles}-cycle mean" if cycles > 1 else ""
    figures = {}
    parts = {"": report.traces} if whole else legible_parts(report.traces)
    for suffix, traces in parts.items():
        whose = f"{plain(traces[0].label)}: " if suffix else ""
        title = _headed(f"{quantity} over {role}{mean}", whose)
        figures[f"loops{suffix}"] = loops_figure(
            list(loop_runs(report, traces, true)), inputs, outputs, title, ideal=not volts
        )
        errors = list(error_runs(report, traces))
        if errors and (whole or len({run.label for run in errors}) <= MOST_CURVES):
            figures[f"errors{suffix}"] = errors_figure(errors, driven, errors_of, _headed(wrong, whose))
    return figures


def _headed(title: str, label: str = "") -> str:
    """Title with a capital letter, or behind a label, which stays as it is written."""
    return label + title if label else title[:1].upper() + title[1:]


def _sweeps(report: Report, over: Over) -> dict[str, Figure]:
    """Error of the reading and, for a compensator, of the true position; without a target the gain."""
    volts = report.scenario.drive is not None
    seen = "Model error, from the sensor's readings" if volts else "Error of the sensor's reading"
    wanted = [(over.figure, "rms_um", "rms error [µm]", seen)]
    if volts and all(row.rms_um is None for row in report.rows):
        wanted = [(over.figure, "gain", "gain [µm/V]", "Gain of the first harmonic")]
    if not volts and not report.reads_truth:
        wanted.append((f"{over.figure}_true", "rms_true_um", "rms error [µm]", "Error of the true position"))
    figures = {}
    for name, merit, quantity, title in wanted:
        curves = sweep_curves(report, merit, over)
        if any(np.isfinite(curve.values).any() for curve in curves):
            figures[name] = sweep_figure(curves, transfers_of(report), quantity, title, over.words)
    return figures


def _driven_quantity(report: Report) -> tuple[Role, str]:
    """What the scenario drives, and its unit."""
    return ("voltage", "V") if report.scenario.drive is not None else ("reference", "µm")


def _excited(report: Report) -> list[str]:
    return list(dict.fromkeys(row.excited_axis for row in report.rows))


def transfers_of(report: Report) -> list[list[str]]:
    """Titles of the panels (output, excited axis) of a sweep."""
    role, _ = _driven_quantity(report)
    square = len(_excited(report)) == len(report.axes) > 1

    def title(measured: str, o: int, excited: str, k: int) -> str:
        reading = symbol(measured, "reading")
        if excited == "all":
            return f"{reading}, all axes driven"
        kind = (", direct" if k == o else ", cross-coupling") if square else ""
        return f"{symbol(excited, role)} to {reading}{kind}"

    return [
        [title(measured, o, excited, k) for k, excited in enumerate(_excited(report))]
        for o, measured in enumerate(report.axes)
    ]


def sweep_curves(report: Report, merit: str, over: Over) -> list[SweepCurve]:
    """One figure of merit over a swept value, a curve for each compensator or model and other swept value."""
    told = told_apart(list(dict.fromkeys(_other(row, over) for row in report.rows)))
    rows_of: dict[str, list[Row]] = {}
    for row in report.rows:
        others = told[_other(row, over)].replace(" um", " µm") if len(told) > 1 else ""
        words = [row.compensator, others]
        rows_of.setdefault(", ".join(word for word in words if word) or "reading", []).append(row)
    bands = {band.place: band for band in report.bands if band.metric == merit}
    identified = report.identified_at if over is FREQUENCY else {}
    curves = []
    for label, rows in rows_of.items():
        places = sorted({over.of(row) for row in rows})
        where = [(row, places.index(over.of(row))) for row in rows]
        found = [(row, at, bands[row.place]) for row, at in where if row.place in bands]
        low, middle, high = (
            _grid(report, len(places), [(row, at, getattr(band, part)) for row, at, band in found])
            for part in ("p5_um", "median_um", "p95_um")
        )
        values = _grid(report, len(places), [(row, at, getattr(row, merit)) for row, at in where])
        mark = identified.get(rows[0].compensator)
        line, band = (middle, (low, high, values)) if found else (values, None)  # of a band: its median
        curves.append(SweepCurve(label, np.array(places), line, mark, band))
    return curves


def _other(row: Row, over: Over) -> Condition:
    """Condition of a row without the value that it is drawn over."""
    own = Condition.of(row)
    return replace(own, frequency_hz=0.0) if over is FREQUENCY else replace(own, trial=None)


def _grid(report: Report, points: int, found: Iterable[tuple[Row, int, float | None]]) -> Array:
    """Values (output, excited axis, point) from single ones; NaN where there is none."""
    excited = _excited(report)
    values = np.full((len(report.axes), len(excited), points), np.nan)
    for row, at, value in found:
        o, k = report.axes.index(row.measured_axis), excited.index(row.excited_axis)
        values[o, k, at] = np.nan if value is None else value
    return values


def _operators(report: Report) -> dict[str, Figure]:
    """Error against the number of operators, if the models differ in it."""
    models = report.operators
    numbers = sorted(models.values())
    if len(numbers) <= MOST_LOOPS:
        return {}
    curves = []
    runs = by_key(report.rows, lambda row: (row.frequency_hz, row.amplitude_v))
    for (frequency_hz, amplitude_v), rows in runs.items():
        found = [(row, numbers.index(models[row.compensator]), row.rms_um) for row in rows]
        label = f"{frequency_hz:g} Hz, {amplitude_v or 0:g} V"
        curves.append(SweepCurve(label, np.array(numbers, float), _grid(report, len(numbers), found)))
    title = "Model error against number of operators"
    figure = sweep_figure(
        curves, transfers_of(report), "rms error [µm]", title, "play operators of each transfer"
    )
    return {"operators": figure}


def _paths(report: Report) -> dict[str, Figure]:
    true, name = _shown_quantity(report)
    runs = [run for trace in report.traces for run in path_runs_of(report, trace, true)]
    volts = report.scenario.drive is not None
    kind = report.scenario.signal.kind.capitalize()
    compared = runs[0].target_um is not None
    what, target = ("predictions of the models", "sensor's reading") if volts else (name, "reference")
    figures = {"path": path_figure(runs, report.axes, target, f"{kind}: {what if compared else name}")}
    if compared:
        runs = [run for trace in report.traces for run in path_runs_of(report, trace, true=not volts)]
        wrong = f"{what} minus {target}" if volts else "error of the true position"
        figures["errors"] = path_errors_figure(runs, report.axes, f"{kind}: {wrong}")
    return figures


def _shown_quantity(report: Report) -> tuple[bool, str]:
    """Whether paths and loops show the true position, and their name.

    A drive in volts shows the reading, as a record does. An assessment of readings also shows the reading.
    """
    if report.scenario.drive is not None or report.reading_first:
        return False, "sensor's reading"
    return True, "true position"


def path_runs_of(report: Report, trace: Trace, true: bool) -> Iterator[PathRun]:
    """Position or reading of a compensator against its reference, or predictions against the reading."""
    response, signal, time_s = trace.response, trace.signal, trace.time_s
    group = swept_label(trace, report.scenario.sweep)
    period = signal.period_s if signal.repeats else float(np.ptp(time_s))
    lap = 1.0 / signal.highest_frequency_hz if signal.smooth else 0.0
    drawn: dict[str, Any] = {"period_s": period, "closes": signal.repeats, "lap_s": lap}
    if response.reference_um is not None:
        output = response.position_um if true else response.reading_um
        yield PathRun(trace.label, group, time_s, response.reference_um, output, **drawn)
        return
    for p in trace.predictions:
        yield PathRun(p.label, group, time_s, response.reading_um, p.reading_um, **drawn)
    if not trace.predictions:
        yield PathRun("reading", group, time_s, None, response.reading_um, **drawn)


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


def legend_labels(report: Report, traces: Sequence[Trace]) -> Iterator[str]:
    """Text of the legend for each trace: only what distinguishes the curves of one figure."""
    compared = len({trace.label for trace in traces}) > 1
    for trace in traces:
        value = swept_label(trace, report.scenario.sweep)
        name = trace.label if compared or not value else ""
        told = value and re.search(rf"(?<![\d.]){re.escape(value)}\b", name)
        yield ", ".join(word for word in (name, "" if told else value) if word)


def loop_runs(report: Report, traces: Sequence[Trace], true: bool) -> Iterator[LoopRun]:
    """Mean measured cycle of each trace, reading or true position, and the predictions of a few models."""
    for trace, label in zip(traces, legend_labels(report, traces), strict=True):
        response, driven = trace.response, driven_of(report, trace)
        wire = response.drive_v if response.reference_um is None else response.reference_um
        shown = trace.predictions if len(trace.predictions) <= MOST_OVERLAYS else ()
        outputs = [response.position_um if true else response.reading_um, *(p.reading_um for p in shown)]
        cycle = _closed_cycle(trace, np.vstack([wire[driven], *outputs]))
        means = np.split(cycle[1:], len(outputs))
        predictions = tuple((p.label, mean) for p, mean in zip(shown, means[1:], strict=True))
        name = label or f"{trace.signal.highest_frequency_hz:g} Hz"
        yield LoopRun(name, driven, cycle[0], means[0], predictions)


def error_runs(report: Report, traces: Sequence[Trace]) -> Iterator[ErrorRun]:
    """First measured cycle of the errors of each trace: of the true position, or of each prediction."""
    for trace, label in zip(traces, legend_labels(report, traces), strict=True):
        response, period = trace.response, trace.signal.period_s
        first = slice(0, round(period / response.sample_time_s) + 1)
        errors = [(p.label, response.reading_um - p.reading_um) for p in trace.predictions]
        if response.reference_um is not None:
            errors = [("", response.position_um - response.reference_um)]
        for name, error_um in errors:
            words, worst_um = ", ".join(word for word in (name, label) if word), float(np.abs(error_um).max())
            cycles = response.time_s[first] / period
            yield ErrorRun(words, driven_of(report, trace), cycles, error_um[:, first], worst_um)


def driven_of(report: Report, trace: Trace) -> int:
    """Number of the input that a trace excites."""
    names = report.inputs if report.scenario.drive is not None else report.axes
    return names.index(trace.excited_axis)


def _closed_cycle(trace: Trace, signals: Array) -> Array:
    """Mean of the measured cycles (signal, sample), its first sample repeated at its end."""
    period, sample_time_s = trace.signal.period_s, trace.response.sample_time_s
    samples = round(period / sample_time_s)
    if signals.shape[1] * sample_time_s < period * (1.0 + 1e-9):
        return signals
    cycle = settled_cycle(signals, 1.0 / period, sample_time_s, min(MOST_PHASES, samples))
    return np.hstack([cycle, cycle[:, :1]])
