"""A figure of merit against frequency: one panel for each output and input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.figures.style import (
    WIDTH_IN,
    Array,
    legend_above,
    letter,
    line_style,
    new_figure,
    plain,
    plain_numbers,
    sparse_markers,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOGARITHMIC_FROM = 12.0  # ratio of the ends from which an axis is logarithmic


@dataclass(frozen=True, eq=False)
class SweepCurve:
    """One compensator or model over frequency.

    label : what the legend calls it
    frequency_hz : (point,) [Hz], increasing
    values : (output, input, point); NaN where there is none
    identified_hz : frequency at which it was identified; None: not at one frequency
    """

    label: str
    frequency_hz: Array
    values: Array
    identified_hz: float | None = None


def sweep_figure(
    curves: Sequence[SweepCurve], panel_titles: Sequence[Sequence[str]], quantity: str, title: str = ""
) -> Figure:
    """Curves against frequency in the paper's arrangement (Figs. 7, 9).

    A vertical tick on a curve stands at the frequency of its identification.

    Parameters
    ----------
    curves : what to draw
    panel_titles : what stands above each panel (output, input)
    quantity : label of the vertical axes, with unit
    title : written above the legend

    Examples
    --------
    >>> f = np.array([10.0, 50.0, 200.0])
    >>> curve = SweepCurve("model", f, np.array([[[0.1, 0.2, 3.0]]]), identified_hz=50.0)
    >>> figure = sweep_figure([curve], [["x"]], "RMS error [um]")
    >>> figure.axes[0].get_yscale()
    'log'
    """
    rows, columns = len(panel_titles), len(panel_titles[0])
    with styled():
        figure = new_figure(0.9 + rows * WIDTH_IN / max(columns, 2) * 0.68)
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        entries: dict[str, Artist] = {}
        for number, curve in enumerate(curves):
            for (o, k), axes in np.ndenumerate(panels):
                line = _draw(axes, curve, curve.values[o, k], number)
                entries.setdefault(plain(curve.label), line)
        _scale(panels, curves)
        for number, axes in enumerate(panels.flat):
            o, k = divmod(number, columns)
            letter(axes, number, panel_titles[o][k])
            axes.set_xlabel("frequency [Hz]" if o == rows - 1 else "")
            axes.set_ylabel(quantity if k == 0 else "")
        if any(_marked_hz(curve) is not None for curve in curves):
            entries["identified here"] = _tick_for_legend()
        legend_above(figure, entries, title)
    return figure


def _draw(axes: Axes, curve: SweepCurve, values: Array, number: int) -> Artist:
    style = line_style(number)
    markers = sparse_markers(len(values), number, markers=9)
    (line,) = axes.plot(curve.frequency_hz, values, markevery=markers, **style)
    here = _marked_hz(curve)
    if here is not None:
        logarithms = np.log(np.maximum(values, 1e-12))
        height = np.exp(np.interp(np.log(here), np.log(curve.frequency_hz), logarithms))
        mark = {"color": style["color"], "markersize": 14, "markeredgewidth": 2.2}
        axes.plot([here], [height], "|", zorder=3, clip_on=False, **mark)
    return line


def _marked_hz(curve: SweepCurve) -> float | None:
    """Frequency of the identification, if the curve passes it."""
    here = curve.identified_hz
    return None if here is None or not curve.frequency_hz[0] <= here <= curve.frequency_hz[-1] else here


def _tick_for_legend() -> Artist:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", marker="|", color="#555555", markersize=11, markeredgewidth=2.2)


def _scale(panels: np.ndarray, curves: Sequence[SweepCurve]) -> None:
    """Logarithmic axes where the values span more than about a decade."""
    frequencies = np.concatenate([curve.frequency_hz for curve in curves])
    values = np.concatenate([curve.values.ravel() for curve in curves])
    values = values[np.isfinite(values)]
    for axes in panels.flat:
        if frequencies.max() >= LOGARITHMIC_FROM * frequencies.min():
            axes.set_xscale("log")
            plain_numbers(axes.xaxis)
        if values.min() > 0.0 and values.max() >= LOGARITHMIC_FROM * values.min():
            axes.set_yscale("log")
            plain_numbers(axes.yaxis)
        else:
            axes.set_ylim(bottom=0.0)
        axes.margins(x=0.02, y=0.08)
