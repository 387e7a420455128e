"""Figure of a comparison: for each model its errors, the error of its compensator, and its parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hammerstein.comparison.result import Comparison, Left
from hammerstein.identification.score import Score
from hammerstein.reporting.figures.style import (
    COLOURS,
    DARK,
    PALE,
    in_lines,
    legend_above,
    letter,
    new_figure,
    plain,
    plain_numbers,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vPX"
NAME_LETTERS = 24
"""Of a line of a model's name beside a panel."""
REASON_LETTERS = 34
"""Of a reason beside a row; the table has longer ones."""
LEAST = 1e-9
"""Percent that stand for none on a logarithmic axis."""


def compared_figure(found: Comparison) -> Figure:
    """Draw the figures of all models side by side.

    Parameters
    ----------
    found : what ``compare`` gave
    """
    names = [entry.name for entry in found.entries]
    labels = [in_lines(f"{entry.name} ({entry.parameters})", NAME_LETTERS) for entry in found.entries]
    with styled():
        figure = new_figure(1.5 + 0.34 * max(5, len(names)))
        panels = figure.subplots(1, 2)
        fitted = [entry.fitted_at for entry in found.entries]
        entries = _draw_errors(panels[0], fitted, "fitted", hollow=bool(found.held))
        if found.held:
            held = [entry.held_at for entry in found.entries]
            entries |= _draw_errors(panels[0], held, "validation", hollow=False)
        _draw_left(panels[1], [entry.left for entry in found.entries])
        quantities = ("rms error [% of range]", "error of its compensator [%]")
        for number, (axes, label) in enumerate(zip(panels, quantities, strict=True)):
            letter(axes, number)
            axes.set(xscale="log", xlabel=label)
            axes.margins(x=0.12, y=0.08)
            plain_numbers(axes.xaxis)
            chosen = names.index(found.recommended)
            band = axes.axhspan(chosen - 0.45, chosen + 0.45, color=PALE, alpha=0.28, zorder=0, linewidth=0)
            axes.set_yticks(range(len(names)), labels)
            axes.set_ylim(len(names) - 0.4, -0.6)
        legend_above(figure, {**entries, "recommended": band})
    return figure


def _draw_errors(
    axes: Axes, scores: Sequence[Mapping[float, Score]], told: str, hollow: bool
) -> dict[str, Artist]:
    """Errors of every model at each frequency."""
    drawn: dict[str, Artist] = {}
    for number, hz in enumerate(scores[0]):
        colour, marker = COLOURS[number % len(COLOURS)], MARKERS[number % len(MARKERS)]
        values = [max(score[hz].mean_percent, LEAST) for score in scores]
        face = "white" if hollow else colour
        (drawn[told if len(scores[0]) == 1 else f"{told}, {hz:g} Hz"],) = axes.plot(
            values, range(len(values)), marker, color=colour, markerfacecolor=face, markersize=6.0, zorder=3
        )
    return drawn


def _draw_left(axes: Axes, left: Sequence[Left]) -> None:
    """One point a model; where there is no number, why not."""
    for place, one in enumerate(left):
        if one.percent is not None:
            axes.plot(max(one.percent, LEAST), place, "o", color=DARK, markersize=5.0, zorder=3)
            continue
        why = one.reason if len(one.reason) <= REASON_LETTERS else "no compensator"
        white = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        across = axes.get_yaxis_transform()
        axes.text(0.03, place, plain(why), transform=across, va="center", color="#666666", bbox=white)
