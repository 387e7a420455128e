"""Figures of merit of a run, their meanings, and the rows that hold them.

To add one, write a function of a ``Measured`` and register it with ``metric``: its column, glossary, claims,
tolerances and baseline follow.
"""

from hammerstein.metrics.arrays import LoopFigures, euclidean, loop_figures, rms, worst
from hammerstein.metrics.metric import KEY, METRICS, Keyed, Measured, Metric, Row, metric, metrics_of

__all__ = [
    "KEY",
    "METRICS",
    "Keyed",
    "LoopFigures",
    "Measured",
    "Metric",
    "Row",
    "euclidean",
    "loop_figures",
    "metric",
    "metrics_of",
    "rms",
    "worst",
]
