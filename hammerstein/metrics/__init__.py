"""Figures of merit: what is measured on a run, what each figure means, and the rows that hold them.

To add one, write a function of a ``Measured`` and register it with ``metric``: its column, glossary, claims,
tolerances and baseline follow.
"""

from hammerstein.metrics.arrays import (
    LoopFigures,
    drift,
    epsilon,
    euclidean,
    loop_figures,
    radial,
    rms,
    worst,
)
from hammerstein.metrics.measured import Measured
from hammerstein.metrics.metric import METRICS, Metric, metric
from hammerstein.metrics.row import KEY, Keyed, Row

__all__ = [
    "KEY",
    "METRICS",
    "Keyed",
    "LoopFigures",
    "Measured",
    "Metric",
    "Row",
    "drift",
    "epsilon",
    "euclidean",
    "loop_figures",
    "metric",
    "radial",
    "rms",
    "worst",
]
