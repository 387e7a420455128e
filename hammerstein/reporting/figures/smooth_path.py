"""Paths through few samples: a circle is drawn as a circle, however few of its samples were kept."""

from __future__ import annotations

import numpy as np

from hammerstein.arrays import Array

POINTS_OF_A_LAP = 60
"""Samples of a turn between which straight lines show no corner: they miss 0.14 % of its radius."""
MOST_HARMONICS = 30
"""Of a path that repeats, as a figure draws it."""
FEWEST_OF_A_SPLINE = 4
"""Points of a cubic."""


def smooth_path(time_s: Array, path: Array, period_s: float, lap_s: float, closed: bool) -> Array:
    """Points (axis, point) of one period of a smooth path of which few samples are known.

    A closed path is drawn by its harmonics, found by least squares from all samples,

        p(t) = c + sum_h a_h cos(2 pi h t / T) + b_h sin(2 pi h t / T),

    as many as the samples of one period tell; an open one by a cubic spline over time.

    Parameters
    ----------
    time_s : (sample,) times [s]
    path : (axis, sample)
    period_s : time that is drawn [s]; of a closed path that after which it closes
    lap_s : time of one turn [s]
    closed : whether the path repeats

    Examples
    --------
    Five samples a turn of a circle:

    >>> t = np.arange(11) / 5
    >>> circle = np.array([np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)])
    >>> radius = np.hypot(*smooth_path(t, circle, 1.0, 1.0, closed=True))
    >>> bool(np.allclose(radius, 1.0))
    True
    """
    fine_s = np.linspace(0.0, period_s, round(2 * POINTS_OF_A_LAP * max(1.0, period_s / lap_s)) + 1)
    passed_s = time_s - time_s[0]
    if not closed:
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(passed_s, path, axis=1)(np.minimum(fine_s, passed_s[-1])))
    samples = round(period_s / float(passed_s[1] - passed_s[0]))
    harmonics = min((samples - 1) // 2, MOST_HARMONICS)
    found, *_ = np.linalg.lstsq(_waves(passed_s / period_s, harmonics), path.T, rcond=None)
    return np.asarray((_waves(fine_s / period_s, harmonics) @ found).T)


def _waves(turns: Array, harmonics: int) -> Array:
    """Columns 1, then cosine and sine of each harmonic (sample, 1 + 2 harmonics)."""
    angle = 2.0 * np.pi * np.outer(turns, np.arange(1, harmonics + 1))
    return np.hstack([np.ones((len(turns), 1)), np.cos(angle), np.sin(angle)])


def is_sparse(time_s: Array, lap_s: float) -> bool:
    """Whether straight lines between samples of a path that turns once in ``lap_s`` [s] show corners."""
    return (
        len(time_s) >= FEWEST_OF_A_SPLINE
        and lap_s / POINTS_OF_A_LAP < float(time_s[1] - time_s[0]) < lap_s / 2
    )
