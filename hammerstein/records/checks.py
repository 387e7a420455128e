"""Checks of measured records: each mistake with its column, row and remedy.

All functions return mistakes instead of raising them, so that one message can list all.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from hammerstein.arrays import Array, Flags, Indices
from hammerstein.errors import InputError, Mistake
from hammerstein.quantities import Range, interval
from hammerstein.records.turning_points import quantum
from hammerstein.signals.text_tables import SHOWN, not_listed, where

MOST_NUMBERS = 50_000_000
"""Most numbers of one variable; a file that declares more is not unpacked."""


def refuse_large(shape: Sequence[int], bytes_each: int = 8) -> None:
    """Refuse an array before it is unpacked, based on the declared shape.

    bytes_each : of an entry; a text counts as so many numbers as would take its place
    """
    numbers = math.prod(int(n) for n in shape) * max(1, bytes_each // 8)
    if numbers > MOST_NUMBERS:
        raise InputError(
            "file",
            f"holds {numbers / 1e6:,.0f} million numbers ({8e-9 * numbers:.3g} GB), but at "
            f"most {MOST_NUMBERS // 10**6} million are allowed: cut it into several records, or use "
            "fewer samples",
        )


FEWEST_SAMPLES = 20  # fewer show no loop
CLIPPED_RUN = 4
"""Consecutive equal extreme samples from which clipping is suspected."""
FEW_GAPS = 0.01
"""Fraction of gaps in the steps, above which the clock jitters."""
AROUND_GAP = 3
"""Samples on each side of a gap over which it must remain."""
SPANS = {
    "input": (1e-4, 1e4, "V", "--input-scale 1e3 if the file is in kV", "--input-scale 1e-3 if it is in mV"),
    "output": (1e-3, 1e5, "um", "--units m or --units mm", "--units nm"),
}
"""Smallest and largest span of a record, their unit, and the unit to try outside."""


def runs(flags: Flags) -> Indices:
    """First and last index of every run of True: (run, 2)."""
    edges = np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8))
    return np.column_stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1])


def gap_mistakes(names: Sequence[str], values: Array, rows: Indices) -> Iterator[Mistake]:
    """Samples without a number, in runs; values (column, sample)."""
    for name, column in zip(names, values, strict=True):
        gaps = runs(~np.isfinite(column))
        for start, stop in gaps[:SHOWN]:
            count = stop - start + 1
            what = "has no finite number" if count == 1 else f"gap of {count} samples without a number"
            yield Mistake(
                where(name, rows, start, stop), f"{what}; repair the record or cut it before the gap"
            )
        yield from not_listed(where(name), len(gaps), "gaps further down")


def far_mistakes(
    names: Sequence[str], values: Array, rows: Indices, limit: Range, unit: str
) -> Iterator[Mistake]:
    """Numbers too large for a voltage or displacement, which would overflow sums; values (column, sample)."""
    for name, column in zip(names, values, strict=True):
        far = runs(np.isfinite(column) & ((column < limit.low) | (column > limit.high)))
        for start, stop in far[:SHOWN]:
            what = (
                f"holds {column[start]:.3g} {unit}, which {limit.words()}; correct the cell, or give a scale"
            )
            yield Mistake(where(name, rows, start, stop), what)
        yield from not_listed(where(name), len(far), "such places further down")


def still_mistakes(names: Sequence[str], values: Array, rows: Indices, kind: str) -> Iterator[Mistake]:
    """Mistake if all columns of one kind are constant; values (column, sample)."""
    if values.size == 0 or any(moves(column) for column in values):
        return
    for name, column in zip(names, values, strict=True):
        yield still_mistake(where(name, rows, 0, len(column) - 1), column, kind)


def still_mistake(place: str, column: Array, kind: str) -> Mistake:
    """Mistake for a constant column."""
    remedy = (
        "add a record that drives it, or name only the driven inputs with --inputs"
        if kind == "input"
        else "check the sensor and its cable, or name only the outputs that move with --outputs"
    )
    return Mistake(place, f"constant {kind}, always {column[0]:.9g}; {remedy}")


def moves(column: Array) -> bool:
    """Whether a column is more than a constant with rounding errors."""
    return float(np.ptp(column)) > 1e-9 * float(np.abs(column).max())


def unit_mistake(place: str, span: float, kind: str) -> Mistake | None:
    """Mistake for a range that is impossible in V or um, with the unit to try."""
    low, high, unit, too_small, too_large = SPANS[kind]
    if low <= span <= high:
        return None
    remedy = too_small if span < low else too_large
    return Mistake(place, f"covers {span:.3g} {unit}, which is impossible; try {remedy}")


def clipping_mistakes(names: Sequence[str], u: Array, y: Array, rows: Indices) -> Iterator[Mistake]:
    """Outputs that stay at an extreme value while the voltages change.

    A hysteretic output is also constant just after a reversal, but only while the voltage moves away from the
    extreme. A quantised output is constant for about one step. Neither counts.
    """
    for name, column in zip(names, y, strict=True):
        places = [*_clipped(u, column, 1.0), *_clipped(u, column, -1.0)]
        if places:
            start, stop = max(places, key=lambda place: place[1] - place[0])
            times = f" ({len(places)} such places)" if len(places) > 1 else ""
            yield Mistake(
                where(name, rows, start, stop),
                f"stays at {column[start]:.6g} while the voltage moves on{times}: sensor or drive "
                "is clipped (lower the amplitude or use a larger range), or inputs and outputs are swapped",
            )


def _clipped(u: Array, column: Array, side: float) -> list[tuple[int, int]]:
    signed = side * column
    places = runs(signed == signed.max())
    places = places[places[:, 1] - places[:, 0] + 1 >= CLIPPED_RUN]
    span = float(np.ptp(column))
    if len(places) == 0 or span == 0.0:
        return []
    centred = u - u.mean(axis=1, keepdims=True)
    gain = np.linalg.lstsq(centred @ centred.T, centred @ (column - column.mean()), rcond=None)[0]
    push = side * gain @ centred  # what the output would do without hysteresis or limits
    limit = max(0.01 * span, 3.0 * quantum(column))
    return [(int(a), int(b)) for a, b in places if push[a : b + 1].max() - push[a] > limit]


def time_mistakes(name: str, time_s: Array, rows: Indices) -> list[Mistake]:
    """Rows at which a time column is not a uniform grid: steps back, gaps, jitter."""
    steps = np.diff(time_s)
    typical = float(np.median(steps))
    back = np.flatnonzero(steps <= 0)
    if back.size:
        k = int(back[0])
        return [
            Mistake(
                where(name, rows, k, k + 1),
                f"time does not increase ({time_s[k]:.9g} s, then {time_s[k + 1]:.9g} s; {back.size} "
                "such steps); write it with more digits, or omit it and give --rate",
            )
        ]
    gaps = np.flatnonzero(steps > 1.5 * typical)
    # with jitter, long and short steps make up for each other
    short = np.count_nonzero(steps < 0.5 * typical)
    if 2 * short < gaps.size <= max(FEW_GAPS * len(steps), 1):
        listed = [_time_gap(name, time_s, rows, int(k), typical) for k in gaps[:SHOWN]]
        return listed + not_listed(where(name), gaps.size, "gaps further down")
    deviation = np.abs(time_s - np.linspace(time_s[0], time_s[-1], len(time_s)))
    if deviation.max() > time_tolerance(time_s):
        k = int(np.argmax(deviation))
        return [
            Mistake(
                where(name, rows, k, k),
                f"non-uniform time: steps from {interval(steps.min())} to {interval(steps.max())}; resample "
                "the record to a uniform sample time, or give --rate if the sampling was uniform",
            )
        ]
    return []


def _time_gap(name: str, time_s: Array, rows: Indices, k: int, typical: float) -> Mistake:
    step = float(time_s[k + 1] - time_s[k])
    missing = max(round(step / typical) - 1, 1)
    return Mistake(
        where(name, rows, k, k + 1),
        f"gap of {interval(step)}, about {missing} missing samples; cut the record there",
    )


def hidden_gaps(name: str, time_s: Array, rows: Indices) -> list[Mistake]:
    """Missing samples according to a time column, in any unit and with any number of digits.

    Jitter and equal instants are no matter where the rate is known; a jump away from the grid that lasts is.
    """
    steps = np.diff(time_s)
    digit = _last_digit(time_s)
    typical = float(np.median(steps))
    if typical <= 2.0 * digit:  # too few digits: the mean says more
        typical = float(time_s[-1] - time_s[0]) / len(steps)
    if not typical > 0.0:
        return []
    gaps = np.flatnonzero(steps > 1.5 * typical + 2.0 * digit)
    lasting = [int(k) for k in gaps if _lasts(time_s, int(k), typical)]
    found = [
        Mistake(
            where(name, rows, k, k + 1),
            f"steps by {steps[k]:.6g} instead of {typical:.6g}: about "
            f"{max(round(steps[k] / typical) - 1, 1)} samples are missing, which --rate does not "
            "repair; cut the record there",
        )
        for k in lasting[:SHOWN]
    ]
    return found + not_listed(where(name), len(lasting), "gaps further down")


def _lasts(time_s: Array, k: int, typical: float) -> bool:
    """Whether the samples behind a long step stay late: those behind jitter do not."""
    before, after = max(k - AROUND_GAP, 0), min(k + 1 + AROUND_GAP, len(time_s) - 1)
    return float(time_s[after] - time_s[before]) > (after - before + 0.5) * typical


def time_tolerance(time_s: Array) -> float:
    """Allowed distance from the uniform grid: a tenth of a sample, or the last digit."""
    step = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    return min(max(0.1 * step, 1.05 * _last_digit(time_s)), 0.6 * step)


def _last_digit(time_s: Array) -> float:
    """Decimal unit of which all instants are multiples; 0 beyond nine digits."""
    for digits in range(10):
        unit = 10.0**-digits
        with np.errstate(over="ignore", invalid="ignore"):  # an instant of 1e308: it has no such digit
            counted = time_s / unit
            if np.all(np.abs(counted - np.round(counted)) < 1e-3):
                return unit
    return 0.0


def sample_time(time_s: Array) -> float:
    """Sample time of a uniform time column [s], for an integer rate [Hz] if the last digit allows one."""
    step = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    rate = round(1.0 / step)
    allowed = 2.0 * max(_last_digit(time_s), 1e-9 * step) / (len(time_s) - 1)
    return 1.0 / rate if rate > 0 and abs(1.0 / rate - step) <= allowed else step
