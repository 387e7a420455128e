"""Figures of merit of a run, their meanings, and the rows that hold them.

To add one, write a function of a ``Measured`` and register it with ``metric``: its column, glossary, claims,
tolerances and baseline follow.
"""

from hammerstein.metrics.metric import (
    KEY as KEY,
    METRICS as METRICS,
    Keyed as Keyed,
    LoopFigures as LoopFigures,
    Measured as Measured,
    Metric as Metric,
    Row as Row,
    euclidean as euclidean,
    loop_figures as loop_figures,
    metric as metric,
    metrics_of as metrics_of,
    rms as rms,
    worst as worst,
)
