"""How far models are off: over all records, at each frequency, and part by part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hammerstein.comparison.fitting import Fitted
from hammerstein.identification.score import Score, score
from hammerstein.identification.static.regressors import Start
from hammerstein.records.record import Record

ALIKE = 1.1
"""Ratio up to which the frequencies of two records count as one."""


def frequencies(records: Sequence[Record]) -> list[float]:
    """Frequency [Hz] of each record, the same number for those that are alike; 0 where nothing is driven.

    Examples
    --------
    >>> def sine(hz):
    ...     u = np.sin(2.0 * np.pi * hz * 1e-3 * np.arange(1000))
    ...     return Record([u], [u], 1e-3)
    >>> frequencies([sine(5.0), sine(20.0), sine(5.02)])
    [5.0, 20.0, 5.0]
    """
    own = [main_hz(record) for record in records]
    groups: list[list[float]] = []
    for hz in sorted(own):
        if groups and hz <= ALIKE * groups[-1][0]:
            groups[-1].append(hz)
        else:
            groups.append([hz])
    return [next(float(f"{np.mean(group):.3g}") for group in groups if hz in group) for hz in own]


def main_hz(record: Record) -> float:
    """Median frequency of the power of the voltages [Hz]; for a sine, its frequency.

    Examples
    --------
    >>> time_s = 1e-3 * np.arange(1000)
    >>> u = (1.0 + time_s) * np.sin(2.0 * np.pi * 5.0 * time_s)
    >>> main_hz(Record([u], [u], 1e-3))
    5.0
    """
    about = record.u_v - record.u_v.mean(axis=1, keepdims=True)
    power = np.cumsum((np.abs(np.fft.rfft(about, axis=1)) ** 2).sum(axis=0))
    if power[-1] == 0.0:
        return 0.0
    lines = np.fft.rfftfreq(record.samples, record.sample_time_s)
    return float(lines[np.searchsorted(power, 0.5 * power[-1])])


def scores_at(one: Fitted, records: Sequence[Record], starts: Sequence[Start]) -> dict[float, Score]:
    """Errors of a model on the records of each frequency, lowest first."""
    own = frequencies(records)
    pairs = list(zip(records, starts, strict=True))
    found = {}
    for hz in sorted(set(own)):
        there = [pair for pair, f in zip(pairs, own, strict=True) if f == hz]
        found[hz] = score(one.candidate, *zip(*there, strict=True))
    return found


def alike(starts: Sequence[Sequence[Start]]) -> list[list[Start]]:
    """Starts (model) (record) of several models, from the samples on that count for every one of them."""
    first = [max(begun.first for begun in each) for each in zip(*starts, strict=True)]
    return [[replace(start, first=k) for start, k in zip(own, first, strict=True)] for own in starts]
