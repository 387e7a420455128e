"""Recorded voltages: the working point of a fit, and their description in the model file.

A record may begin at any voltage. The plays of a model that rests do not know where zero is, so that every
record is counted from the voltage at which it began; the model's working point is that of the first record
that began at rest.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.arrays import Array
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import WithLoop
from hammerstein.identification.score import Candidate, begun
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.record import Record, begins_at_rest, driven_inputs

AT_AN_END = 0.01
"""Part of its range within which a voltage begins at an end of it."""


def counted(record: Record) -> Record:
    """The same record with its voltages counted from their first values.

    >>> u = 90.0 * np.sin(np.linspace(0.0, 12.0, 300)) - 90.0
    >>> begun = counted(Record([u], [5.0 * u], 1e-3))
    >>> begun.rest_v, float(begun.u_v[0, 0])
    (array([-90.]), 0.0)
    """
    first = record.u_v[:, 0]
    if not first.any():
        return record
    return replace(record, u_v=record.u_v - first[:, None], rest_v=record.rest_v + first, verified=True)


def voltages_of(
    records: Sequence[Record], ready: Sequence[Record], starts: Sequence[InitialState], best: Candidate
) -> Voltages:
    """Working point, range and history of every input over the records.

    The working point is where the first record began that drives the input and began at rest: with a dead
    start, at an end of its range, or so judged. Where all began in motion it is the middle of the range.

    Parameters
    ----------
    records : as they were read
    ready : the same without their dead start, counted from where they began
    starts : what went before each of them, for the model
    """
    low: Array = np.array([record.u_v.min(axis=1) for record in records]).min(axis=0)
    high: Array = np.array([record.u_v.max(axis=1) for record in records]).max(axis=0)
    rest = [_middle(*ends) for ends in zip(low.tolist(), high.tolist(), strict=True)]
    for record, counted, start in reversed(list(zip(records, ready, starts, strict=True))):
        for k in driven_inputs(record):
            if start.kind == "rest" or _began_at_rest(record, k):
                rest[k] = float(counted.rest_v[k])
    conditioned = _began_conditioned(ready, starts, best, low, high)
    return Voltages.of(rest, low, high).model_copy(update={"conditioned": conditioned})


def _began_conditioned(
    ready: Sequence[Record], starts: Sequence[InitialState], best: Candidate, low: Array, high: Array
) -> bool:
    """Whether every record that does not begin in motion began near the outputs to which a drive to the
    highest, then to the lowest voltage leads, and away from those of an actuator that was never driven.
    """
    found = []
    for record, start in zip(ready, starts, strict=True):
        if start.first or record.period_samples is not None or isinstance(best.dynamics, WithLoop):
            continue
        hysteresis = best.hysteresis.counted_from(record.rest_v).on_grid(record.sample_time_s)
        memory = begun(hysteresis, record, start)
        if start.kind == "repeated":
            memory = hysteresis.respond(record.u_v, memory)[1]
        stands = np.zeros((len(low), 1))
        history = np.hstack([stands, np.stack([high, low], axis=1) - record.rest_v[:, None], stands])
        history[np.ptp(record.u_v, axis=1) == 0.0] = 0.0
        here, virgin = (hysteresis.respond(stands, one)[0][:, 0] for one in (memory, hysteresis.rest()))
        driven = hysteresis.standing(history)[0]
        found.append(bool(np.abs(here - driven).sum() < np.abs(here - virgin).sum()))
    return bool(found) and all(found)


def _began_at_rest(record: Record, k: int) -> bool:
    u = record.u_v[k]
    margin = AT_AN_END * float(np.ptp(u))
    return bool(u[0] <= u.min() + margin or u[0] >= u.max() - margin) or begins_at_rest(record)


def _middle(low: float, high: float) -> float:
    """Middle of a range, to a thousandth of it: it was never measured."""
    step = 10.0 ** (math.floor(math.log10(high - low)) - 3) if high > low else 1.0
    return round(0.5 * (low + high) / step) * step
