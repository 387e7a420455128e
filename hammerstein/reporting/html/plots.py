"""Curves over frequency, loops, paths and errors over time, with one legend and one slider for all."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bokeh.layouts import column, row
from bokeh.models import (
    CategoricalSlider,
    ColumnDataSource,
    CustomJS,
    Div,
    GlyphRenderer,
    HoverTool,
    Legend,
    LegendItem,
    LogTicker,
    UIElement,
)
from bokeh.plotting import figure

from hammerstein.arrays import Array
from hammerstein.escaping import clean
from hammerstein.experiment.report import Report, Trace
from hammerstein.experiment.selection import swept_over
from hammerstein.reporting.figures.choice import path_runs_of, sweep_curves, transfers_of
from hammerstein.reporting.figures.loop_data import driven_of, errors_of, loop_of, swept_label
from hammerstein.reporting.figures.path import PathRun
from hammerstein.reporting.figures.style import COLOURS, DARK, thin_path, thin_trace
from hammerstein.reporting.figures.sweep import LOGARITHMIC_FROM, SweepCurve
from hammerstein.signals import OnAxes

MOST_VALUES = 60_000
"""Numbers of all curves together: as single precision in base64, a third of a megabyte."""
FEWEST, MOST_POINTS = 60, 1000  # of a curve
MOST_STEPS = 12  # of the slider
HEIGHT = 320
DASHES = ("solid", "dashed", "dotdash", "dotted", "dashdot")
REFERENCE = "reference"


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve in one panel, for one step of the slider."""

    panel: str
    label: str
    x: Array
    y: Array


@dataclass
class Panels:
    """What all panels share: colours, and the curves of each label."""

    labels: list[str]
    curves: dict[str, list[GlyphRenderer]] = field(default_factory=dict)

    def panel(self, title: str, x: str, y: str, **options: Any) -> figure:
        """An empty panel that shares the page with its neighbours."""
        plot = figure(
            title=_words(title),
            x_axis_label=_words(x),
            y_axis_label=_words(y),
            height=HEIGHT,
            min_width=260,
            sizing_mode="stretch_width",
            styles={"flex": "1 1 420px"},
            tools="pan,box_zoom,wheel_zoom,reset,save",
            active_drag="box_zoom",
            **options,
        )
        plot.toolbar.logo = None
        plot.toolbar.autohide = True
        tooltips = [("", "$name"), (_words(x), "@x{0.000}"), (_words(y), "@y{0.0000}")]
        plot.add_tools(HoverTool(tooltips=tooltips, line_policy="nearest"))
        return plot

    def draw(self, plot: figure, label: str, source: ColumnDataSource) -> None:
        """Draw a curve and remember whose it is."""
        style = self.style(label)
        line = plot.line("x", "y", source=source, line_width=1.8, name=_words(label) or "reading", **style)
        self.curves.setdefault(label, []).append(line)

    def style(self, label: str) -> dict[str, Any]:
        """Colour and dashes of a label, the same in every panel and in the figures."""
        if label == REFERENCE:
            return {"line_color": DARK, "line_dash": "dashed"}
        place = self.labels.index(label)
        return {
            "line_color": COLOURS[place % len(COLOURS)],
            "line_dash": DASHES[(place // len(COLOURS)) % len(DASHES)],
        }

    def legend(self) -> figure:
        """A legend for all panels: a click on a name hides its curves in each of them."""
        plot = figure(
            height=10 + 25 * math.ceil(len(self.curves) / 2),
            toolbar_location=None,
            sizing_mode="stretch_width",
            outline_line_color=None,
            x_range=(0.0, 1.0),
            y_range=(0.0, 1.0),
            min_border=0,
        )
        plot.axis.visible = False
        plot.grid.visible = False
        items = []
        for label, lines in self.curves.items():
            key = plot.line([-2.0, -1.0], [0.0, 0.0], line_width=1.8, **self.style(label))
            hide = CustomJS(
                args={"curves": lines}, code="for (const curve of curves) curve.visible = this.visible"
            )
            key.js_on_change("visible", hide)
            items.append(LegendItem(label={"value": _words(label) or "reading"}, renderers=[key]))
        legend = Legend(
            items=items,
            click_policy="hide",
            location=(0, 0),
            ncols=2 if len(items) > 1 else 1,
            border_line_color=None,
        )
        plot.add_layout(legend, "center")
        return plot


def plots_of(report: Report) -> UIElement | None:
    """All plots of a report below each other; None where there are none."""
    stepped = list(_steps(report)) if report.traces else []
    sweeps = _sweeps(report)
    labels = [label for curves, *_ in sweeps for label in (curve.label for curve in curves)]
    labels += [curve.label for _, curves in stepped for curve in curves]
    panels = Panels([label for label in dict.fromkeys(labels) if label != REFERENCE])
    parts: list[Any] = []
    for curves, titles, quantity, title, x_label in sweeps:
        parts += [Div(text=f"<h3>{title}</h3>"), _drawn_sweep(panels, curves, titles, quantity, x_label)]
    if stepped:
        parts += _drawn_steps(panels, report, stepped)
    return column([panels.legend(), *parts], sizing_mode="stretch_width") if parts else None


def _sweeps(report: Report) -> list[tuple[list[SweepCurve], list[list[str]], str, str, str]]:
    """Figures of merit over frequency or trial, if there are several; label of the axis last."""
    over = swept_over(report, 2)
    if over is None:
        return []
    wanted = [
        ("rms_um", "Error of the reading", "rms error [µm]"),
        *[("rms_true_um", "Error of the true position", "rms error [µm]")] * (not report.reads_truth),
    ]
    if all(row.rms_um is None for row in report.rows):
        wanted = [("gain", "Gain", "gain [µm/V]")]
    found = []
    for merit, title, quantity in wanted:
        curves = sweep_curves(report, merit, over)
        if any(np.isfinite(curve.values).any() for curve in curves):
            found.append((curves, transfers_of(report), quantity, title, over.words))
    return found


def _drawn_sweep(
    panels: Panels,
    curves: Sequence[SweepCurve],
    titles: Sequence[Sequence[str]],
    quantity: str,
    x_label: str,
) -> UIElement:
    """One panel a transfer, all on one pair of axes."""
    x = np.concatenate([curve.x for curve in curves])
    values = np.concatenate([curve.values.ravel() for curve in curves])
    values = values[np.isfinite(values)]
    logarithmic = {
        "x_axis_type": "log" if x.max() >= LOGARITHMIC_FROM * x.min() else "linear",
        "y_axis_type": "log"
        if values.min() > 0.0 and values.max() >= LOGARITHMIC_FROM * values.min()
        else "linear",
    }
    drawn: list[figure] = []
    for o, line in enumerate(titles):
        for k, words in enumerate(line):
            shared = {"x_range": drawn[0].x_range, "y_range": drawn[0].y_range} if drawn else {}
            plot = panels.panel(words.replace("$", ""), x_label, quantity, **logarithmic, **shared)
            if logarithmic["x_axis_type"] == "log":
                plot.xaxis.ticker = LogTicker(mantissas=[1, 2, 5], num_minor_ticks=0)
            for curve in curves:
                known = np.isfinite(curve.values[o, k])
                source = ColumnDataSource(_columns(curve.x[known], curve.values[o, k][known]))
                panels.draw(plot, curve.label, source)
            drawn.append(plot)
    return _wrapped(drawn)


def _words(text: str) -> str:
    """Text that bokeh shows as it is: no formula, for which it would fetch another library."""
    found = clean(text)
    for sign in ("$$", "\\(", "\\["):
        found = found.replace(sign, " ".join(sign))
    return found


def _wrapped(plots: Sequence[figure]) -> UIElement:
    """Side by side where there is room."""
    return row(list(plots), sizing_mode="stretch_width", styles={"flex-wrap": "wrap"}, spacing=8)


def _drawn_steps(
    panels: Panels, report: Report, steps: Sequence[tuple[str, list[Curve]]]
) -> Iterator[UIElement]:
    """Loops, paths and errors over time, the values of the sweep on a slider."""
    places = list(dict.fromkeys((curve.panel, curve.label) for _, curves in steps for curve in curves))
    places.sort(key=lambda place: "time [" in place[0])  # loops and paths first
    frames = [{(curve.panel, curve.label): curve for curve in curves} for _, curves in steps]
    sources, contents = [], []
    drawn: dict[str, figure] = {}
    for panel, label in places:
        title, x, y = panel.split("\n")
        options = {"match_aspect": True} if title == "Path" else {}
        if panel not in drawn:
            drawn[panel] = panels.panel(title, x, y, **options)
        content = [_columns_of(frame.get((panel, label))) for frame in frames]
        source = ColumnDataSource(content[0])
        panels.draw(drawn[panel], label, source)
        sources.append(source)
        contents.append(content)
    if len(steps) > 1:
        names = [name for name, _ in steps]
        slider = CategoricalSlider(
            categories=names,
            value=names[0],
            title="Shown below",
            sizing_mode="stretch_width",
            margin=(16, 24, 8, 12),
        )
        code = (
            "const step = this.categories.indexOf(this.value);"
            "sources.forEach((source, k) => { source.data = contents[k][step]; });"
        )
        slider.js_on_change("value", CustomJS(args={"sources": sources, "contents": contents}, code=code))
        yield slider
    yield Div(text="<h3>Loops, paths and errors over time</h3>")
    yield _wrapped(list(drawn.values()))


def _columns_of(curve: Curve | None) -> Mapping[str, Any]:
    return _columns(np.zeros(0), np.zeros(0)) if curve is None else _columns(curve.x, curve.y)


def _columns(x: Array, y: Array) -> dict[str, Any]:
    return {"x": np.asarray(x, np.float32), "y": np.asarray(y, np.float32)}


def _steps(report: Report) -> Iterator[tuple[str, list[Curve]]]:
    """Curves of each value of the sweep, thinned to what a page can hold."""
    groups: dict[str, list[Trace]] = {}
    for trace in report.traces:
        name = swept_label(trace, report.scenario.sweep)
        groups.setdefault(name or f"{trace.signal.highest_frequency_hz:g} Hz", []).append(trace)
    names = list(groups)
    if len(names) > MOST_STEPS:
        names = [names[round(i * (len(names) - 1) / (MOST_STEPS - 1))] for i in range(MOST_STEPS)]
    signal = report.scenario.signal
    curves_of = _axis_curves if isinstance(signal, OnAxes) and signal.axis != "all" else _path_curves
    found = [(name, [c for trace in groups[name] for c in curves_of(report, trace)]) for name in names]
    most = MOST_VALUES // max(1, 2 * sum(len(curves) for _, curves in found))
    points = int(np.clip(most, FEWEST, MOST_POINTS))
    for name, curves in found:
        once = {(curve.panel, curve.label): curve for curve in curves}  # a reference is that of all
        yield name, [_thinned(curve, points) for curve in once.values()]


def _thinned(curve: Curve, points: int) -> Curve:
    over_time = "\ntime [" in curve.panel
    x, y = thin_trace(curve.x, curve.y, points) if over_time else thin_path([curve.x, curve.y], points)
    return Curve(curve.panel, curve.label, x, y)


def _axis_curves(report: Report, trace: Trace) -> Iterator[Curve]:
    """Loops, and errors over a cycle, of one driven axis."""
    volts = report.scenario.drive is not None
    driven = driven_of(report, trace)
    name = (report.inputs if volts else report.axes)[driven]
    loop = loop_of(trace, trace.label, driven)
    x_label = f"{'voltage' if volts else 'reference'} [{'V' if volts else 'µm'}]"
    for o, axis in enumerate(report.axes):
        panel = f"Loop: {name} to {axis}\n{x_label}\nreading [µm]"
        yield Curve(panel, trace.label, loop.input_, loop.outputs_um[o])
        for label, predicted in loop.predictions_um:
            yield Curve(panel, label, loop.input_, predicted[o])
    for error in errors_of(trace, "" if volts else trace.label, driven):
        for o, axis in enumerate(report.axes):
            panel = f"Error of {axis}, {name} driven\ntime [cycles]\nerror [µm]"
            yield Curve(panel, error.label, error.cycles, error.errors_um[o])


def _path_curves(report: Report, trace: Trace) -> Iterator[Curve]:
    """The path in the plane, and errors over time, all axes driven."""
    for run in path_runs_of(report, trace):
        yield from _path(report, run)


def _path(report: Report, run: PathRun) -> Iterator[Curve]:
    shown = run.shown
    time_ms = 1e3 * run.time_s[shown]
    if len(report.axes) == 2:
        panel = f"Path\n{report.axes[0]} [µm]\n{report.axes[1]} [µm]"
        yield Curve(panel, run.label, *run.plane_of(run.output_um))
        if run.target_um is not None:
            yield Curve(panel, REFERENCE, *run.plane_of(run.target_um))
    else:
        for o, axis in enumerate(report.axes):
            yield Curve(f"{axis}\ntime [ms]\n{axis} [µm]", run.label, time_ms, run.output_um[o, shown])
    if run.target_um is None:
        return
    for (name, error), axis in zip(run.errors(), [*report.axes, *[""] * 2], strict=False):
        title = f"Error of {axis}" if not name else name.capitalize()
        yield Curve(f"{title}\ntime [ms]\n{name or 'error'} [µm]", run.label, time_ms, error[shown])
