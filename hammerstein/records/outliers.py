"""Outliers: detects, excludes and lists lost cells, spikes and glitches.

A sample is suspect if its column jumps away and back, or leaves the range of all others. A robust fit of the
outputs decides: plays and delayed copies of the voltages, fitted without the suspects. A suspect output is
excluded if its error is far larger than elsewhere. A suspect voltage is excluded if the outputs are explained
as well without it. Sharp edges, pulses and ringing that the outputs follow are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array, Flags, Indices
from hammerstein.errors import Mistake
from hammerstein.hysteresis import play
from hammerstein.records.checks import runs
from hammerstein.signals.text_tables import SHOWN, where

LAGS = (1, 2, 3, 5, 8, 13)
"""Samples by which voltages are delayed: they take up what dynamics and delay do at the edges."""
FITTED = 40_000
"""Number of samples for a fit."""
CHUNK = 256
"""Samples of one product: small enough that BLAS does it on one core."""


def regressors(u: Array, plays: int, stride: int = 1) -> Array:
    """Plays of a voltage whose thresholds divide half its range, from rest, and the voltage some samples ago.

    Parameters
    ----------
    u : (sample,) voltage [V]
    plays : how many
    stride : samples from one that is kept to the next

    Returns
    -------
    (row, sample), counted from the first voltage
    """
    v = u - u[0]
    thresholds = 0.5 * float(np.ptp(u)) * np.arange(plays) / plays
    rows = [play(v, [threshold])[0, ::stride] for threshold in thresholds]
    rows += [np.concatenate([np.zeros(d), v[:-d]])[::stride] for d in LAGS if d < len(u)]
    return np.vstack(rows)


@dataclass(frozen=True, eq=False)
class Products:
    """Products of signals with each other, for fits of one signal by others.

    Parameters
    ----------
    gram : (signal, signal) sums over the samples
    samples : how many
    """

    gram: Array
    samples: int

    @classmethod
    def of(cls, signals: Array) -> Products:
        """Products of signals (signal, sample)."""
        count, samples = signals.shape
        whole = samples - samples % CHUNK
        stack = signals[:, :whole].reshape(count, -1, CHUNK).transpose(1, 0, 2)
        rest = signals[:, whole:]
        return cls(np.matmul(stack, stack.transpose(0, 2, 1)).sum(axis=0) + rest @ rest.T, samples)

    def fit(self, columns: Sequence[int], target: int) -> tuple[Array, float]:
        """Least-squares weights of signals that fit another signal, and the rms error.

        Examples
        --------
        >>> t = np.arange(10.0)
        >>> weights, left = Products.of(np.vstack([t, np.ones(10), 3.0 * t + 2.0])).fit([0, 1], 2)
        >>> weights.round(9), round(left, 6)
        (array([3., 2.]), 0.0)
        """
        used = list(columns)
        size = np.sqrt(np.maximum(np.diag(self.gram)[used], np.finfo(float).tiny))
        gram, cross = self.gram[np.ix_(used, used)], self.gram[used, target]
        scaled = np.linalg.lstsq(gram / np.outer(size, size), cross / size, rcond=1e-12)[0]
        weights = np.asarray(scaled / size)
        squares = self.gram[target, target] - 2.0 * weights @ cross + weights @ gram @ weights
        return weights, float(np.sqrt(max(squares, 0.0) / self.samples))


MOST = 0.01
"""Part of the samples that may be left out."""
USUAL = 0.02
"""Part of the samples on each side that the usual range leaves out: more than outliers are allowed to be."""
FAR = 0.5
"""Distance from the usual range, in parts of it, from which a sample is suspected."""
JUMP = 4.0  # times the usual large step
SMALLEST = 0.02
"""A jump is suspected from this many times the usual large step on, and from this part of the range."""
NEAR = 16
"""Steps on each side, than whose median a jump is so many times larger, too."""
LONGEST = 0.005
"""Longest excursion away and back that is suspected, in parts of the record."""
APART = 3.0
"""Distance of a value that stands for nothing (-9999) from all others, in parts of their range."""
SURE = 4.0
"""A suspect is left out if the fit misses it by this many times the usual large error."""
BETTER = 0.7
"""Error of the fit without a spike of the voltage, in parts of that with it, up to which it is left out:
either right behind the spike or everywhere."""
NO_WORSE = 1.05
"""The same error everywhere, up to which it may be better right behind the spike alone."""
EXACT = 1e-12
"""Error below which a fit is exact [um]."""
PLAYS = 8
"""Of the fit by which samples are judged."""
BRIEF = 3
"""Samples that are more than a spike has."""
ROUNDS = 4
"""A fit without the outliers may find further ones."""


class Outliers(NamedTuple):
    """Excluded samples of one column.

    Parameters
    ----------
    column : its name
    rows : (sample,) rows in the file, from 1
    values : (sample,) what was read there
    samples : of the whole record
    """

    column: str
    rows: Indices
    values: Array
    samples: int

    def describe(self) -> str:
        """List rows and readings, the first few of many.

        Examples
        --------
        >>> Outliers("x", np.array([7, 8, 30]), np.array([-9999.0, -9999.0, 200.0]), 4000).describe()
        'rows 7 to 8 (-9999), row 30 (200): 3 of 4000 samples'
        """
        starts = np.flatnonzero(np.diff(self.rows, prepend=-1) != 1)
        stops = np.append(starts[1:], len(self.rows)) - 1
        words = []
        for start, stop in list(zip(starts, stops, strict=True))[:SHOWN]:
            first, last = self.rows[start], self.rows[stop]
            place = f"row {first}" if first == last else f"rows {first} to {last}"
            words.append(f"{place} ({self.values[start]:.6g})")
        more = f" and {len(starts) - SHOWN} more places" if len(starts) > SHOWN else ""
        return f"{', '.join(words)}{more}: {len(self.rows)} of {self.samples} samples"


class Mended(NamedTuple):
    """Voltages and displacements (axis, sample) without outliers, and a flag for each sample left out."""

    u: Array
    y: Array
    lost_u: Flags
    lost_y: Flags


def without_outliers(u: Array, y: Array) -> Mended:
    """Voltages (input, sample) [V] and displacements (output, sample) [um] with outliers replaced.

    A straight line replaces a lost voltage. The robust fit replaces a lost displacement, shifted by its error
    on both sides, so that the sample has nearly no weight in later fits.

    Examples
    --------
    >>> u = 10.0 * np.sin(np.linspace(0.0, 40.0, 4000))[None]
    >>> y = 5.0 * u
    >>> y[0, 1234] = 200.0
    >>> found = without_outliers(u, y)
    >>> np.flatnonzero(found.lost_y[0]), bool(abs(found.y[0, 1234] - 5.0 * u[0, 1234]) < 1e-6)
    (array([1234]), True)
    """
    suspect_u = np.array([_suspects(row) for row in u])
    suspect_y = np.array([_suspects(row) for row in y])
    nothing = np.zeros_like(suspect_y)
    if not (suspect_u.any() or suspect_y.any()):
        return Mended(u, y, suspect_u, nothing)
    lost_u = _spikes(u, y, suspect_u, suspect_y) if suspect_u.any() else suspect_u
    bridged = np.array([_bridged(row, flags) for row, flags in zip(u, lost_u, strict=True)])
    if not suspect_y.any():
        return Mended(bridged, y, lost_u, nothing)
    lost_y, fit = _confirmed(bridged, y, suspect_y)
    mended = np.array([f + _bridged(row - f, flags) for row, f, flags in zip(y, fit, lost_y, strict=True)])
    return Mended(bridged, np.where(lost_y, mended, y), lost_u, lost_y)


def _spikes(u: Array, y: Array, suspects: Flags, suspect_y: Flags) -> Flags:
    """Suspected voltages without which the outputs are explained better: right behind each, or everywhere.

    Right behind it they must be missed by far more than elsewhere; everywhere, for plays remember a spike. A
    high peak that the actuator was driven with is explained by it.
    """
    trial = np.array([_bridged(row, flags) for row, flags in zip(u, suspects, strict=True)])
    anywhere = np.any(suspects, axis=0)
    aside = suspect_y.copy()
    for start, stop in runs(anywhere):
        aside[:, max(start - 1, 0) : stop + LAGS[-1] + 2] = True  # as far behind each as the fit looks back
    with_them, without = (y - _fit(v, y, aside) for v in (u, trial))
    ratio = _ratio(*(_level(np.abs(error), aside, 0.5) for error in (without, with_them)))
    if ratio <= BETTER:
        return suspects
    lost, limit = np.zeros_like(suspects), SURE * _level(np.abs(with_them), aside, 1.0 - USUAL)
    for start, stop in runs(anywhere) if ratio <= NO_WORSE else ():
        behind = np.s_[:, start : stop + LAGS[-1] + 2]
        near = [np.sqrt(np.mean(error[behind] ** 2, axis=1)) for error in (without, with_them)]
        missed = np.abs(with_them[behind]).max(axis=1) > limit
        if missed.any() and _ratio(*near) <= BETTER:
            lost[:, start : stop + 1] = suspects[:, start : stop + 1]
    return lost


def _ratio(errors: Array, others: Array) -> float:
    """Mean ratio of errors (output,) to others."""
    return float(np.exp(np.mean(np.log(np.maximum(errors, EXACT) / np.maximum(others, EXACT)))))


def _confirmed(u: Array, y: Array, suspects: Flags) -> tuple[Flags, Array]:
    """Suspects that a fit without them misses, again with those that it does not miss (redescending)."""
    lost, smooth = suspects, _smooth(u)
    for _ in range(ROUNDS):
        fit = _fit(u, y, lost)
        error, kinks = np.abs(y - fit), _kinks(y - fit)
        least = SMALLEST * np.ptp(fit, axis=1)
        limits = [SURE * _level(what, lost, 1.0 - USUAL) + least for what in (error, kinks)]
        again = suspects & ((error > limits[0][:, None]) | smooth & (kinks > limits[1][:, None]))
        if (again == lost).all():
            break
        lost = again
    return lost, fit


def _kinks(x: Array) -> Array:
    """Distance of each sample (row, sample) from those BRIEF before and behind; 0 where these differ more."""
    wide = np.pad(x, ((0, 0), (BRIEF, BRIEF)), mode="edge")
    before, behind = wide[:, : -2 * BRIEF], wide[:, 2 * BRIEF :]
    away = np.abs(x - 0.5 * (before + behind))
    return np.where(np.abs(behind - before) <= away, away, 0.0)


def _smooth(u: Array) -> Flags:
    """Samples (sample,) at and before which no voltage jumps.

    There no actuator moves away and back within fewer samples than BRIEF by itself. So the error of such a
    spike is compared with that around it: a fit without the resonance misses some motion by as much.
    """
    size = np.abs(np.diff(u, axis=1, prepend=u[:, :1]))
    sharp = np.any(size > JUMP * np.quantile(size, 1.0 - 2.0 * USUAL, axis=1)[:, None], axis=0)
    counts = np.cumsum(np.pad(sharp, (LAGS[-1], BRIEF)))  # of the jumps up to each sample
    window = LAGS[-1] + BRIEF + 1
    return np.asarray(counts[window - 1 :] == np.concatenate([[0], counts[:-window]]))


def outlier_mistakes(outliers: Sequence[Outliers]) -> list[Mistake]:
    """Columns with too many outliers."""
    return [
        Mistake(
            where(found.column),
            f"outliers in {found.describe()} ({100 * len(found.rows) / found.samples:.1f} %), more "
            f"than the {100 * MOST:.0f} % that may be excluded; repair the record",
        )
        for found in outliers
        if len(found.rows) > max(MOST * found.samples, 1)
    ]


def listed(names: Sequence[str], values: Array, lost: Flags, rows: Indices) -> list[Outliers]:
    """Outliers of each affected column; values (column, sample) as read."""
    return [
        Outliers(name, rows[flags], row[flags], len(row))
        for name, row, flags in zip(names, values, lost, strict=True)
        if flags.any()
    ]


def _suspects(x: Array) -> Flags:
    """Samples that leave the range of the others, or jump away and back; none if they are too many.

    More than one percent of a record is no outlier but part of the drive, such as the upper level of a pulse
    train.
    """
    suspects = _all_suspects(x)
    return suspects if np.count_nonzero(suspects) <= max(MOST * len(x), 1) else np.zeros_like(suspects)


def _all_suspects(x: Array) -> Flags:
    low, high = np.quantile(x, [USUAL, 1.0 - USUAL])
    span = float(high - low)
    suspects = _placeholder(x)
    steps = np.diff(x)
    size = np.abs(steps)
    far = (x > high + FAR * span) | (x < low - FAR * span) if span > 0.0 else suspects
    inside = runs(far)
    inside = inside[(inside[:, 0] > 0) & (inside[:, 1] < len(x) - 1)]  # a record may begin or end elsewhere
    starts, stops = inside.T
    sharp = _stand_out(size, starts - 1) | _stand_out(size, stops)  # the step into each, or out of it
    for start, stop, is_sharp in zip(starts.tolist(), stops.tolist(), sharp, strict=True):
        if is_sharp or not _swings_back(x, start, stop):
            suspects[start : stop + 1] = True
    usual = np.quantile(size, 1.0 - 2.0 * USUAL)
    jumps = np.flatnonzero(size > max(JUMP * usual, SMALLEST * span))
    jumps = jumps[_stand_out(size, jumps)]
    if 0 < jumps.size <= 4.0 * MOST * len(x) + 4:
        longest = max(LONGEST * len(x), 3.0)
        taken: set[int] = set()  # by a shorter excursion: what lies between two spikes is none
        for a, b in sorted(pairwise(jumps.tolist()), key=lambda ends: ends[1] - ends[0]):
            away_and_back = steps[a] * steps[b] < 0.0 and b - a <= longest and taken.isdisjoint((a, b))
            if away_and_back and abs(x[b + 1] - x[a]) < 0.5 * min(size[a], size[b]):
                suspects[a + 1 : b + 1] = True
                taken |= {a, b}
    return suspects


def _stand_out(size: Array, places: Indices) -> Flags:
    """Whether steps are large among those near them: those of a resonance, however large, are alike.

    size : (step,) of all steps; places : (place,) of those asked for; there are none before and behind
    """
    there = (places >= 0) & (places < len(size))
    around = np.pad(size, NEAR, constant_values=np.nan)[places[there, None] + np.arange(2 * NEAR + 1)]
    large = np.zeros(len(places), dtype=bool)
    large[there] = size[places[there]] > JUMP * np.nanmedian(around, axis=1)
    return large


def _swings_back(x: Array, start: int, stop: int) -> bool:
    """Whether an excursion has one to the other side beside it, half as far or farther, as ringing has.

    The whole half wave counts, of which an excursion may be no more than the tip. Both are about the middle
    of all samples: no step overshoots by more than its height.
    """
    off = x - np.median(x)
    back = off * off[start] <= 0.0
    start = start - int(np.argmax(np.append(back[start::-1], True))) + 1
    stop = stop + int(np.argmax(np.append(back[stop:], True))) - 1
    reach = 4 * (stop - start + 1) + NEAR
    around = off[max(start - reach, 0) : stop + 1 + reach]
    return bool(min(around.max(), -around.min()) >= 0.5 * np.abs(around).max())


def _placeholder(x: Array) -> Flags:
    """A value that stands for nothing, the same to the last digit: far from the range of all others."""
    flags = np.zeros(len(x), dtype=bool)
    for extreme in (x.min(), x.max()):
        same = x == extreme
        rest = x[~same]
        if rest.size >= (1.0 - MOST) * len(x) and np.ptp(rest) > 0.0:
            distance = min(abs(extreme - rest.min()), abs(extreme - rest.max()))
            if distance > APART * np.ptp(rest):
                flags |= same
    return flags


def _bridged(x: Array, flags: Flags) -> Array:
    """A row with straight lines over the flagged samples."""
    if not flags.any() or flags.all():
        return x
    samples, kept = np.arange(len(x)), ~flags
    return np.asarray(np.where(flags, np.interp(samples, samples[kept], x[kept]), x))


def _fit(u: Array, y: Array, aside: Flags) -> Array:
    """Outputs (output, sample) by plays and delayed copies of the voltages, fitted without some samples."""
    x = np.vstack([*(regressors(row, PLAYS) for row in u if np.ptp(row) > 0.0), np.ones((1, y.shape[1]))])
    stride = max(y.shape[1] // FITTED, 1)
    fit = np.empty_like(y)
    for o, (row, flags) in enumerate(zip(y, aside, strict=True)):
        used = np.flatnonzero(~flags)[::stride]
        weights, _ = Products.of(np.vstack([x[:, used], row[used]])).fit(range(len(x)), len(x))
        fit[o] = weights @ x
    return fit


def _level(error: Array, aside: Flags, share: float) -> Array:
    """Error (output,) below which this share of the samples lies that are not set aside; infinite of none."""
    return np.array(
        [
            np.quantile(row[~flags], share) if not flags.all() else np.inf
            for row, flags in zip(error, aside, strict=True)
        ]
    )
