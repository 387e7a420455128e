"""What a spread is due to: one bar for each uncertain parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hammerstein.arrays import Array
from hammerstein.experiment.report import TOO_FEW
from hammerstein.reporting.figures.style import DARK, legend_above, letter, line_style, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.figure import Figure

FILLED = 0.8  # of the height that a parameter has
PALE_ALPHA = 0.35
"""Of the total effect, behind the first order."""


@dataclass(frozen=True, eq=False)
class SensitivityBars:
    """Indices of one compensator.

    label : what the legend calls it
    parameters : names, from the top
    first, total : (parameter, 3) index of the parameter alone and with others, and its lower and upper limit;
        NaN where the draws were too few
    """

    label: str
    parameters: tuple[str, ...]
    first: Array
    total: Array


def sensitivity_figure(bars: Sequence[SensitivityBars], title: str = "") -> Figure:
    """First and total indices as bars, a group for each parameter; none where the draws were too few.

    Parameters
    ----------
    bars : what to draw; all have the same parameters
    title : written above the legend

    Examples
    --------
    >>> index = np.array([[0.7, 0.6, 0.8], [0.2, 0.1, 0.3]])
    >>> figure = sensitivity_figure([SensitivityBars("exact", ("weights", "noise"), index, index)])
    >>> [label.get_text() for label in figure.axes[0].get_yticklabels()]
    ['weights', 'noise']
    """
    names = bars[0].parameters
    places, height = np.arange(len(names), dtype=np.float64), FILLED / len(bars)
    with styled():
        figure = new_figure(1.2 + 0.24 * len(names) * max(2, len(bars)), columns=1)
        axes = figure.subplots()
        entries: dict[str, Artist] = {}
        for number, own in enumerate(bars):
            colour = line_style(number)["color"]
            middle = places + height * (number - 0.5 * (len(bars) - 1))
            known = np.isfinite(own.total[:, 0])
            total, low, high = own.total[known].T
            axes.barh(middle[known], total, height, color=colour, alpha=PALE_ALPHA, linewidth=0.0)
            first = np.nan_to_num(own.first[:, 0])
            alone = axes.barh(middle, first, 0.6 * height, color=colour, linewidth=0.0)
            entries[own.label] = alone.patches[0]
            axes.hlines(middle[known], low, high, color=DARK, linewidth=0.8)
            for place in middle[~known]:
                axes.text(0.0, place, f" {TOO_FEW}", color=colour, va="center")
        axes.set_yticks(places, names)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("share of the variance")
        axes.set_xlim(left=min(0.0, *(float(np.nan_to_num(own.first[:, 0]).min()) for own in bars)))
        letter(axes, 0)
        legend_above(figure, entries, title)
    return figure
