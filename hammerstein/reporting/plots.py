"""Conversion of matplotlib figures to bokeh: interactive, with values at the pointer."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh import models
from bokeh.layouts import column, row
from bokeh.plotting import figure
from matplotlib.colors import to_hex

from hammerstein.escaping import clean
from hammerstein.reporting.figures.style import thin_path, thin_trace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

MOST_VALUES = 60_000
"""Numbers of all curves together: as single precision in base64, a third of a megabyte."""
FEWEST = 60  # points of a curve
Data = Mapping[str, Any]
HEIGHT = 320
"""Of a plot [px]."""
DASHES = ("dashed", "dotdash", "dotted", "dashdot")


def plots_of(
    figures: Mapping[str, Figure], steps: Mapping[str, Mapping[str, Figure]]
) -> models.UIElement | None:
    """All figures below each other, one step at a time; None without figures."""
    every = [*figures.values(), *(figure for step in steps.values() for figure in step.values())]
    lines = sum(len(axes.lines) for figure in every for axes in figure.axes)
    most = max(FEWEST, MOST_VALUES // (2 * max(1, lines)))
    curves: dict[str, list[models.Renderer]] = {}
    always = [_Plots(figure, most, curves) for figure in figures.values()]
    first = {name: _Plots(figure, most, curves) for name, figure in next(iter(steps.values()), {}).items()}
    parts = [part for plots in always for part in plots.parts()]
    if len(steps) > 1:
        sources = {
            (name, *key): source for name, plots in first.items() for key, source in plots.sources.items()
        }
        contents = [
            {(name, *key): data for name, figure in step.items() for key, data in _curves(figure, most)}
            for step in steps.values()
        ]
        parts.append(_slider([_words(name) for name in steps], sources, contents))
    parts += [part for plots in first.values() for part in plots.parts()]
    return column(parts, sizing_mode="stretch_width") if parts else None


def _slider(
    names: Sequence[str],
    sources: Mapping[tuple[Any, ...], models.ColumnDataSource],
    contents: Sequence[Mapping[tuple[Any, ...], Data]],
) -> models.CategoricalSlider:
    """Slider that puts the curves of one step into the panels."""
    slider = models.CategoricalSlider(
        categories=list(names),
        value=names[0],
        title="Shown below",
        sizing_mode="stretch_width",
        margin=(16, 24, 8, 12),
    )
    none = {name: np.zeros(0, np.float32) for name in "xy"}
    code = (
        "const step = this.categories.indexOf(this.value);"
        "sources.forEach((source, k) => { source.data = contents[k][step]; });"
    )
    shown = [[content.get(key, none) for content in contents] for key in sources]
    swap = models.CustomJS(args={"sources": list(sources.values()), "contents": shown}, code=code)
    slider.js_on_change("value", swap)
    return slider


def _curves(figure: Figure, most: int) -> Iterator[tuple[tuple[int, int], Data]]:
    """Points of each line of each panel, by their numbers: few, but with every peak over time."""
    for panel, axes in enumerate(figure.axes):
        for number, line in enumerate(axes.lines):
            x, y = (np.asarray(values, float) for values in line.get_data())
            few = thin_trace(x, y, most) if (np.diff(x) > 0.0).all() else thin_path([x, y], most)
            yield (panel, number), dict(zip("xy", (values.astype(np.float32) for values in few), strict=True))


def _panel(axes: Axes, earlier: Sequence[tuple[Axes, figure]]) -> figure:
    """An empty panel with the scales and labels of the axes; those that share a scale move together."""
    scales = {name: "log" if getattr(axes, f"{name}axis").get_scale() == "log" else "linear" for name in "xy"}
    options: dict[str, Any] = {f"{name}_axis_type": scale for name, scale in scales.items()}
    options["match_aspect"] = axes.get_aspect() == 1.0
    for name, shared in (("x_range", axes.get_shared_x_axes()), ("y_range", axes.get_shared_y_axes())):
        found = [getattr(plot, name) for other, plot in earlier if shared.joined(axes, other)]
        options |= {name: found[0]} if found else {}
    x, y = _words(axes.get_xlabel()), _words(axes.get_ylabel())
    plot = figure(
        title=_words(f"{axes.get_title('left')} {axes.get_title('right')}"),
        x_axis_label=x,
        y_axis_label=y,
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
    tooltips = [("", "$name"), (x, "@x{0.000}"), (y, "@y{0.0000}")]
    plot.add_tools(models.HoverTool(tooltips=tooltips, line_policy="nearest"))
    if scales["x"] == "log":
        plot.xaxis.ticker = models.LogTicker(mantissas=[1, 2, 5], num_minor_ticks=0)
    return plot


class _Plots:
    """Plots of one figure.

    sources : points of each line of each panel, by their numbers
    """

    def __init__(self, drawn: Figure, most: int, curves: dict[str, list[models.Renderer]]):
        self._styles: dict[str, dict[str, Any]] = {}  # of each label, the same in every panel
        self._curves = curves  # of each label, in all figures
        self._title = _words(drawn.legends[0].get_title().get_text())
        self.sources = {key: models.ColumnDataSource(dict(data)) for key, data in _curves(drawn, most)}
        plots: list[tuple[Axes, figure]] = []
        for number, axes in enumerate(drawn.axes):
            plots.append((axes, _panel(axes, plots)))
            self._draw(number, *plots[-1])
        self._panels = [plot for _, plot in plots]

    def parts(self) -> list[Any]:
        """A legend, and panels side by side where there is room; every figure must have been drawn."""
        wrapped = {"flex-wrap": "wrap"}
        return [self._legend(), row(self._panels, sizing_mode="stretch_width", styles=wrapped, spacing=8)]

    def _draw(self, panel: int, axes: Axes, plot: figure) -> None:
        """Lines, single points and bands of the axes."""
        for number, line in enumerate(axes.lines):
            label, colour = str(line.get_label()), to_hex(line.get_color())
            source = self.sources[panel, number]
            if line.get_linestyle() == "None":
                plot.scatter("x", "y", source=source, color=colour, size=min(line.get_markersize(), 8.0))
                continue
            style = {
                "line_color": colour,
                "line_alpha": line.get_alpha() or 1.0,
                "line_dash": self._dash(line),
                "line_width": 1.3 * line.get_linewidth(),
            }
            self._styles.setdefault(label, style)
            found = plot.line("x", "y", source=source, name=_words(label), **style)
            self._curves.setdefault(label, []).append(found)
        for band in axes.collections:
            x, y = np.asarray(band.get_paths()[0].vertices).T
            colour = to_hex(np.asarray(band.get_facecolor())[0].tolist())
            found = plot.patch(x, y, color=colour, alpha=band.get_alpha(), line_width=0)
            self._curves.setdefault(str(band.get_label()), []).append(found)

    def _dash(self, line: Line2D) -> str:
        """Broken lines of one colour differ in their dashes."""
        if line.get_linestyle() == "-":
            return "solid"
        label, colour = str(line.get_label()), to_hex(line.get_color())
        if label in self._styles:
            return str(self._styles[label]["line_dash"])
        alike = [style for style in self._styles.values() if style["line_color"] == colour]
        return DASHES[len(alike) % len(DASHES)]

    def _legend(self) -> figure:
        """A legend for all panels: a click on a name hides its curves in every figure."""
        plot = figure(
            height=35 + 25 * math.ceil(len(self._styles) / 2),
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
        for label, style in self._styles.items():
            key = plot.line([-2.0, -1.0], [0.0, 0.0], **style)
            code = "for (const curve of curves) curve.visible = this.visible"
            key.js_on_change("visible", models.CustomJS(args={"curves": self._curves[label]}, code=code))
            items.append(models.LegendItem(label={"value": _words(label)}, renderers=[key]))
        legend = models.Legend(
            items=items,
            title=self._title,
            click_policy="hide",
            location=(0, 0),
            ncols=2 if len(items) > 1 else 1,
            border_line_color=None,
        )
        plot.add_layout(legend, "center")
        return plot


def _words(text: str) -> str:
    """Text that bokeh shows as it is: no formula, for which it would fetch another library."""
    found = " ".join(clean(text.replace("\\$", "\ue000").replace("$", "").replace("\ue000", "$")).split())
    for sign in ("$$", "\\(", "\\["):
        found = found.replace(sign, " ".join(sign))
    return found
