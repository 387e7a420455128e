"""Record of an actuator: voltages, displacements, excitation of its inputs, and repaired samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import InitVar, dataclass, field, replace
from itertools import chain

import numpy as np

from hammerstein.arrays import Array, Indices, freeze, frozen
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.escaping import clean
from hammerstein.notebook_repr import NotebookRepr
from hammerstein.quantities import POSITION_UM, VOLTAGE_V, interval, no_name, unique
from hammerstein.records.checks import (
    FEWEST_SAMPLES,
    clipping_mistakes,
    far_mistakes,
    gap_mistakes,
    still_mistakes,
    unit_mistake,
)
from hammerstein.records.outliers import Outliers, listed, outlier_mistakes, without_outliers
from hammerstein.records.turning_points import dead_band, noise_rms, quantum
from hammerstein.signals.text_tables import where


@dataclass(frozen=True, eq=False)
class Record(NotebookRepr):
    """One experiment on one actuator.

    Parameters
    ----------
    u_v : (input, sample) voltages [V]; outliers, at most one percent, are replaced as ``outliers`` says
    y_um : (output, sample) displacements [um]; the same
    sample_time_s : time between two samples [s]
    inputs, outputs : names of the axes; ``u1``, ``u2``, ... and ``y1``, ``y2``, ... if not given; a name that
        is repeated is numbered
    source : origin of the record, for messages
    rows : (sample,) row of each sample in its file, from 1
    period_samples : length of one period of a periodic experiment; None if it is not known
    rest_v : (input,) voltage that ``u_v`` is relative to [V]; zero, for absolute voltages, if not given
    outliers : excluded samples, from `hammerstein.records.outliers`
    verified : True skips the checks, for a part of a checked record

    Raises
    ------
    InputError : gaps, too few samples, too many outliers, constant inputs or outputs, clipped sensor,
        impossible units

    Examples
    --------
    >>> u = np.sin(np.linspace(0.0, 12.0, 300))
    >>> record = Record([u], [5.0 * u], 1e-3)
    >>> record
    Record('record': 300 samples of 1 ms; u1 -1 to 1 V; y1 -5 to 5 um)
    """

    u_v: Array
    y_um: Array
    sample_time_s: float
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()
    source: str = "record"
    rows: Indices = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    period_samples: int | None = None
    rest_v: Array = field(default_factory=lambda: np.empty(0), repr=False)
    outliers: tuple[Outliers, ...] = field(default=(), repr=False)
    verified: InitVar[bool] = False

    def __post_init__(self, verified: bool) -> None:
        u, y = (frozen(np.asarray(v, dtype=np.float64, order="C")) for v in (self.u_v, self.y_um))
        self._refuse_shapes(u, y)
        rows = np.asarray(self.rows, dtype=np.int64)
        rows = rows.copy() if rows.size else np.arange(1, u.shape[1] + 1)
        freeze(rows)
        for name, value in (
            ("u_v", u),
            ("y_um", y),
            ("sample_time_s", float(self.sample_time_s)),
            ("inputs", unique(self.inputs or [f"u{k + 1}" for k in range(len(u))])),
            ("outputs", unique(self.outputs or [f"y{o + 1}" for o in range(len(y))])),
            ("rows", rows),
            ("rest_v", frozen(self.rest_v if np.size(self.rest_v) else np.zeros(len(u)))),
        ):
            object.__setattr__(self, name, value)
        self._refuse_names()
        if verified:
            return
        refuse(self.source, self._gaps() or self._mend() or self._mistakes())

    def __repr__(self) -> str:
        parts = [f"{self.samples} samples of {interval(self.sample_time_s)}"]
        for names, values, unit in ((self.inputs, self.u_v, "V"), (self.outputs, self.y_um, "um")):
            spans = zip(names, values, strict=True)
            parts.append(", ".join(f"{n} {v.min():.4g} to {v.max():.4g} {unit}" for n, v in spans))
        return f"Record({self.source!r}: {'; '.join(parts)})"

    def _refuse_shapes(self, u: Array, y: Array) -> None:
        if u.ndim != 2 or y.ndim != 2 or u.shape[1] != y.shape[1] or 0 in u.shape or 0 in y.shape:
            raise InputError(
                self.source,
                f"u_v has shape {u.shape} and y_um {y.shape}; give (input, sample) and (output, sample)",
            )
        if u.shape[0] > u.shape[1]:
            what = f"u_v has shape {u.shape}, more inputs than samples; transpose it: (input, sample)"
            raise InputError(self.source, what)
        if not (np.isfinite(self.sample_time_s) and self.sample_time_s > 0):
            raise InputError(self.source, f"sample_time_s is {self.sample_time_s:g}; it must be above 0")

    def _refuse_names(self) -> None:
        for name in (*self.inputs, *self.outputs):
            if why := no_name(name):
                raise InputError(self.source, [Mistake(f"column {clean(name[:60])}", f"{why}; rename it")])
        counts = len(self.inputs), len(self.outputs), len(self.rows)
        wanted = len(self.u_v), len(self.y_um), self.samples
        if counts != wanted:
            raise InputError(
                self.source,
                f"has {wanted[0]} inputs, {wanted[1]} outputs and {wanted[2]} samples, but {counts[0]} input "
                f"names, {counts[1]} output names and {counts[2]} row numbers",
            )

    def _gaps(self) -> list[Mistake]:
        both = ((self.inputs, self.u_v, self.rows), (self.outputs, self.y_um, self.rows))
        gaps = [gap for columns in both for gap in gap_mistakes(*columns)]
        far = [*far_mistakes(*both[0], VOLTAGE_V, "V"), *far_mistakes(*both[1], POSITION_UM, "um")]
        what = f"{self.samples} samples are too few; give {FEWEST_SAMPLES} or more, at least one full cycle"
        return [*gaps, *far, *([Mistake("length", what)] if self.samples < FEWEST_SAMPLES else [])]

    def _mend(self) -> list[Mistake]:
        """Replace outliers; mistakes where there are too many."""
        found = without_outliers(self.u_v, self.y_um)
        outliers = listed(self.inputs, self.u_v, found.lost_u, self.rows)
        outliers += listed(self.outputs, self.y_um, found.lost_y, self.rows)
        mistakes = outlier_mistakes(outliers)
        if outliers and not mistakes:
            object.__setattr__(self, "outliers", tuple(outliers))
            object.__setattr__(self, "u_v", frozen(found.u))
            object.__setattr__(self, "y_um", frozen(found.y))
        return mistakes

    def _mistakes(self) -> list[Mistake]:
        u, y, rows = self.u_v, self.y_um, self.rows
        still = still_mistakes(self.inputs, u, rows, "input"), still_mistakes(self.outputs, y, rows, "output")
        units = _unit_mistakes(self.inputs, u, "input"), _unit_mistakes(self.outputs, y, "output")
        return [*chain(*still)] or [*chain(*units), *clipping_mistakes(self.outputs, u, y, rows)]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return int(self.u_v.shape[1])

    @property
    def rate_hz(self) -> float:
        """Sample rate [Hz]."""
        return 1.0 / self.sample_time_s

    def part(self, start: int, stop: int) -> Record:
        """Samples start to stop - 1 as a record of their own; they keep their row numbers."""
        u, y, rows = self.u_v[:, start:stop], self.y_um[:, start:stop], self.rows[start:stop]
        return replace(self, u_v=u, y_um=y, rows=rows, verified=True)


def _unit_mistakes(names: Sequence[str], values: Array, kind: str) -> list[Mistake]:
    """Units are judged by the column that moves most: a cross-coupling may be as small as it likes."""
    spans = np.ptp(values, axis=1)
    largest = int(np.argmax(spans))
    mistake = unit_mistake(where(names[largest]), float(spans[largest]), kind)
    return [mistake] if mistake else []


DRIVEN_SHARE = 0.01
"""An input that moves by less than this part of the largest one is held, not driven."""
FEWEST_AT_REST = 3  # samples, before a drift at rest is spoken of
RESTING = 1e-4
"""Motion of an output that still counts as rest, in parts of its range."""
TREND_PARTS = 4  # of the time at rest, whose means show a trend
GROWS = 0.6
"""Largest deviation of the first half of a time, in parts of that of the whole, below which it is no flicker
about a constant voltage: half of it for a ramp, a quarter for a ramp that starts smoothly."""
VISITED = 0.05
"""An extreme counts as visited from this part of the range on."""


def driven_inputs(record: Record) -> tuple[int, ...]:
    """Inputs that were driven, counted from 0; the others were held and may carry noise.

    Parameters
    ----------
    record : voltages and displacements

    Examples
    --------
    >>> u = np.sin(np.linspace(0.0, 12.0, 300))
    >>> driven_inputs(Record([u, 0.0 * u + 0.2], [5.0 * u], 1e-3))
    (0,)
    """
    spans = np.ptp(record.u_v, axis=1)
    return tuple(int(k) for k in np.flatnonzero(spans > DRIVEN_SHARE * spans.max()))


def driven_alone(record: Record, k: int, start: int, stop: int) -> bool:
    """Whether the other inputs are constant between two samples, both included.

    Parameters
    ----------
    record : voltages and displacements
    k : input, from 0
    start, stop : samples
    """
    spans = np.ptp(record.u_v[:, start : stop + 1], axis=1)
    others = np.delete(spans, k)
    return bool((others <= DRIVEN_SHARE * np.ptp(record.u_v, axis=1).max()).all())


def dead_start(record: Record) -> int:
    """Samples before the last one at which every driven voltage still has its first value.

    Zero if an output still moves at the constant voltage, because ringing and creep show its dynamics.

    Parameters
    ----------
    record : voltages and displacements
    """
    return 0 if moves_while_held(record) else _held(record)


def begins_at_rest(record: Record) -> bool:
    """Whether voltages and outputs are constant for long enough at the beginning."""
    return dead_start(record) + 1 >= FEWEST_AT_REST


def moves_while_held(record: Record) -> bool:
    """Whether an output rings or creeps at the beginning while every driven voltage is constant."""
    held = _held(record)
    return not all(_rests(y[: held + 1], y) for y in record.y_um)


def _held(record: Record) -> int:
    return min(_last_still(record.u_v[k]) for k in driven_inputs(record))


def _rests(still: Array, whole: Array) -> bool:
    """Whether an output shows only noise while the voltage is constant."""
    if len(still) < FEWEST_AT_REST:
        return True
    noise = max(noise_rms(whole), quantum(whole), RESTING * float(np.ptp(whole)))
    trend = np.array_split(still, min(TREND_PARTS, len(still)))
    allowed = 4.0 * noise / np.sqrt(len(trend[0]))
    return (
        float(still.std()) <= 2.0 * noise and float(np.ptp([part.mean() for part in trend])) <= 2.0 * allowed
    )


def run_in(record: Record) -> int:
    """Samples until every driven voltage has visited both extremes, which erases earlier history."""
    last = 0
    for k in driven_inputs(record):
        u = record.u_v[k]
        margin = VISITED * float(np.ptp(u))
        low, high = np.argmax(u <= u.min() + margin), np.argmax(u >= u.max() - margin)
        last = max(last, int(low), int(high))
    return last


def _last_still(u: Array) -> int:
    """Last sample before the motion; the ramp inside the dead band belongs to the motion."""
    away = np.abs(u - u[0])
    first = int(np.argmax(away > min(dead_band(u), 0.05 * float(np.ptp(u)))))
    part = max(first // 2, 1)
    while part > 1 and away[: part // 2].max() < GROWS * away[:part].max():
        part //= 2  # what grows in time is a smooth start, which belongs to the motion
    return int(np.flatnonzero(away[:first] <= away[:part].max())[-1])
