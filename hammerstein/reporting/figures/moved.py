"""Numbers of a baseline and of a run in one plot, with their tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import hammerstein.reporting.figures.style as style
from hammerstein.arrays import Array
from hammerstein.quantities import by_key
from hammerstein.regression.compare import Numbers, all_tolerances, deviation, limit, tolerance_of
from hammerstein.reporting.figures.sweep import log_where_wide
from hammerstein.scenario.scenario import Tolerance

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_COURSES = 3
"""Most curves of one figure; more would be too small to read."""
SWEPT = {
    "frequency_hz": "frequency [Hz]",
    "amplitude_um": "amplitude [µm]",
    "amplitude_v": "amplitude [V]",
    "trial": "trial",
}
NAMED = {
    "compensator": "{}",
    "excited_axis": "{} driven",
    "measured_axis": "position {}",
    "frequency_hz": "{} Hz",
    "amplitude_um": "{} µm",
    "amplitude_v": "{} V",
    "trial": "trial {}",
}
"""Description of the difference of curves."""
UNITS = {"um": "µm", "hz": "Hz", "v": "V", "deg": "deg", "percent": "%"}
LARGE, LEAST_SHARE = 10.0, 0.1
"""Change, in parts of what is allowed, from which the axis is logarithmic, and what stands for none there."""
LEAST_ALLOWED = 1e-300
"""Smallest tolerance, to keep the quotient finite."""


class SweptNumber(NamedTuple):
    """One number of one row, over the values of a sweep.

    x, accepted, now, allowed : (point,)
    """

    label: str
    x_label: str
    x: Array
    accepted: Array
    now: Array
    moved: Array
    allowed: Array

    @property
    def excess(self) -> float:
        """Largest deviation in units of the tolerance."""
        return float(np.max(np.abs(self.moved) / np.maximum(self.allowed, LEAST_ALLOWED)))


def courses_of(
    metric: str, accepted: Numbers, now: Numbers, tolerances: Mapping[str, Tolerance]
) -> list[SweptNumber]:
    """Curves of a number that both sides have, the largest change first.

    A number of all axes together, such as a distance, is in the rows of each: it is one curve.
    """
    both = [key for key in accepted if metric in accepted[key] and metric in now.get(key, {})]
    swept = next((name for name in SWEPT if len({dict(key).get(name) for key in both}) > 1), None)
    groups = by_key(both, lambda key: tuple(item for item in key if item[0] != swept))
    tolerance = tolerance_of(metric, all_tolerances(tolerances))
    same = set.intersection(*map(set, groups)) if len(groups) > 1 else set()
    found: dict[object, SweptNumber] = {}
    for rest, keys in groups.items():
        x = [float(dict(key).get(swept, 0.0)) if swept else float(n) for n, key in enumerate(keys, start=1)]
        order = np.argsort(x, kind="stable")
        values = [(accepted[keys[i]][metric], now[keys[i]][metric]) for i in order]
        moved = [deviation(metric, after, before) for before, after in values]
        allowed = [limit(before, tolerance) for before, _ in values]
        told = [item for item in rest if item[0] != "measured_axis"]
        course = (*told, *values)
        label = _words([item for item in (told if course in found else rest) if item not in same])
        each = (np.array(x)[order], *np.array(values, float).T, np.array(moved), np.array(allowed))
        found[course] = SweptNumber(label, SWEPT[swept] if swept else "", *each)
    return sorted(found.values(), key=lambda course: -course.excess)


def moved_figure(courses: Sequence[SweptNumber], metric: str) -> Figure:
    """Old curve, tolerance and new curve (a), and the change in units of the tolerance (b).

    Parameters
    ----------
    courses : of one number; the first few are drawn
    metric : name of the number, with its unit
    """
    shown = courses[:MOST_COURSES]
    with style.drawing(1.1 + 0.35 * style.WIDTH_IN + 0.2 * len(shown)) as figure:
        left, right = figure.subplots(1, 2)
        entries: dict[str, Artist] = {}
        far = max(course.excess for course in shown) > LARGE
        for number, course in enumerate(shown):
            entries[style.plain(course.label)] = _draw(
                left, right, course, number, LEAST_SHARE if far else 0.0
            )
        (entries["baseline with tolerance"],) = left.plot([], [], color=style.PALE, linewidth=4.0, alpha=0.6)
        right.axhspan(0.0, 1.0, color=style.PALE, alpha=0.3, linewidth=0.0)
        log_where_wide(left, np.concatenate([side for c in shown for side in (c.accepted, c.now)]))
        if far:
            right.set_yscale("log")
            right.set_ylim(bottom=LEAST_SHARE)
            style.plain_numbers(right.yaxis)
        for axes, label in ((left, _quantity(metric)), (right, "|change| / allowed change")):
            axes.set(xlabel=shown[0].x_label, ylabel=label)
            if axes.get_yscale() == "linear":
                style.few_ticks(axes)
            if not shown[0].x_label:
                places = range(1, len(shown) + 1)
                axes.set(xticks=places, xlim=(0.5, len(shown) + 0.5), xlabel="place in the legend")
        style.letter(left, 0)
        style.letter(right, 1, "grey: allowed" + f"; lowest: {LEAST_SHARE:g} or less" * far)
        style.legend_above(figure, entries)
    return figure


def _draw(left: Axes, right: Axes, course: SweptNumber, number: int, least: float) -> Artist:
    """Draw a course before and now; numbers that nothing was swept for stand beside each other.

    least : share of what is allowed that stands for less
    """
    pen = style.line_style(number) | {"markersize": 3.0, "linewidth": 1.0}
    before: dict[str, Any] = {"color": pen["color"], "linewidth": 4.0, "alpha": 0.3}
    x = course.x
    if not course.x_label:
        x, pen["marker"] = x + number, pen.get("marker") or "o"
        before |= {"marker": "s", "markersize": 10.0}
    left.plot(x, course.accepted, **before)
    low, high = course.accepted - course.allowed, course.accepted + course.allowed
    left.fill_between(x, low, high, color=pen["color"], alpha=0.2, linewidth=0.0)
    share = np.abs(course.moved) / np.maximum(course.allowed, LEAST_ALLOWED)
    right.plot(x, np.maximum(share, least), **pen)
    (line,) = left.plot(x, course.now, **pen)
    return line


def _words(key: Sequence[tuple[str, str | float]]) -> str:
    """What tells a course from others.

    >>> _words([("compensator", "inverse"), ("measured_axis", "x"), ("claim", "C1")])
    'inverse, position x, claim C1'
    """
    shown = [(name, f"{value:g}" if isinstance(value, float) else value) for name, value in key]
    named = [NAMED.get(name, f"{name.replace('_', ' ')} {{}}").format(value) for name, value in shown]
    return ", ".join(named) or "all rows"


def _quantity(metric: str) -> str:
    """Label of an axis that shows a number of a row.

    >>> _quantity("rms_true_um"), _quantity("gain")
    ('rms true [µm]', 'gain')
    """
    if metric == "value":
        return "value judged, in its unit"
    name, _, unit = metric.rpartition("_")
    return style.plain(
        f"{name.replace('_', ' ')} [{UNITS[unit]}]" if unit in UNITS else metric.replace("_", " ")
    )
