"""Faults of a record that a model would otherwise attribute to the actuator.

Every suspicion is a comparison: the outputs are fitted by plays and delayed copies of the voltages, once as
they are and once with what the fault would add. A fault is named only where that explains far more.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.records.checks import runs
from hammerstein.records.outliers import FITTED, Products, regressors
from hammerstein.records.record import Record, driven_inputs, run_in
from hammerstein.records.turning_points import noise_rms
from hammerstein.signals.units import spoken

PLAYS = 16  # of the fit by which drift and bending are judged
REMAINS = 0.25
"""Part of a record that must remain after its run-in for the tests of drift and saturation."""
DRIFT = 0.005
"""Smallest drift that is reported, in parts of the largest range of the outputs."""
DRIFT_EXPLAINS = 0.75
"""Largest error ratio with and without a trend in time from which it is drift."""
BENT = 0.01
"""Error of a fit, in parts of the largest range, from which it is asked whether an output saturates."""
BENT_EXPLAINS = 0.6
"""Part to which a bend must lower that error."""
FLAT = 0.75
"""Slope at an end, in parts of the largest, below which an output saturates."""
STEEPER = 1.02
"""Slope, in parts of the steepest inside, from which an end is no saturation."""
TOP = np.linspace(0.55, 0.95, 17)
"""Levels, in parts of the range, above which a command may be clipped."""
STANDS = 0.1
"""Slope above such a level, in parts of the one below, under which the output stands still."""
STEEP = 0.5
"""Slope below it, in parts of the mean one, that tells a limit from a curve."""
RETURNS = 0.2
"""Slope of the way back right below a limit, in parts of the mean one: a magnet stays where it is."""
CORNER = 0.015
"""Part of the range about a limit in which the output must get as far as it does at all, within as much."""
SHARP = 0.8
"""Slope right below a limit, in parts of the one before, that tells a limit from saturation."""
FEWEST = 8
"""Samples from which a slope is believed."""
LONG = 9
"""Samples from which a part at the limit has a shape."""
JUMP = 0.1  # of the voltage, in parts of its range: below, it moves steadily
SURE = 5.0  # times the noise
HUMP = 0.01
"""Rise and fall of an output while the voltage stands at its limit, in parts of its range."""


class Fault(NamedTuple):
    """A fault and the affected outputs.

    Parameters
    ----------
    source, outputs : record and names of the outputs
    text : description, with rows and remedy
    drift_um : drift of the output [um]; 0 for other faults
    bent_um : rms error of plays alone [um], if the output saturates; 0 for other faults
    hump_um : rise or fall, and return, of the first output while a voltage is constant [um]; 0 for other
        faults
    held : first and last sample of that constant voltage
    """

    source: str
    outputs: tuple[str, ...]
    text: str
    drift_um: float = 0.0
    bent_um: float = 0.0
    hump_um: float = 0.0
    held: tuple[int, int] = (0, 0)


def faults(record: Record) -> list[Fault]:
    """Clipped commands, clipped readings of a voltage, drift and saturation of one record.

    Examples
    --------
    >>> t = np.linspace(0.0, 4.0, 4000)
    >>> u = 10.0 * np.sin(2.0 * np.pi * t)
    >>> [fault.text[:26] for fault in faults(Record([u], [5.0 * u + 2.0 * t], 1e-3))]
    ['y1 of record drifts by 6.6']
    """
    stride = max(record.samples // FITTED, 1)
    blocks = {k: regressors(record.u_v[k], PLAYS, stride) for k in driven_inputs(record)}
    found = [*_clipped_commands(record, stride, blocks), *_clipped_readings(record)]
    first = run_in(record) // stride  # what was before the record is forgotten there
    samples = len(range(0, record.samples, stride))
    if found or first > (1.0 - REMAINS) * samples:
        return found
    x = np.vstack([*blocks.values(), np.ones((1, samples))])[:, first:]
    largest = float(np.ptp(record.y_um, axis=1).max())
    for o, name in enumerate(record.outputs):
        row = record.y_um[o, ::stride][first:]
        trial = _Trial.of(x, row - row.mean())
        rows = record.rows[::stride][first:]
        drift_um, whose = _drift(trial, largest), f"{spoken(name)} of {PurePath(record.source).name}"
        if drift_um:
            seconds = float(rows[-1] - rows[0]) * record.sample_time_s
            text = (
                f"drifts by {drift_um:.3g} um from row {rows[0]} to row {rows[-1]}, in {seconds:.3g} s, "
                "independently of the voltages: let the set-up settle before you record, or subtract the "
                "trend from this column"
            )
            found.append(Fault(record.source, (name,), f"{whose} {text}", drift_um=drift_um))
        if text := _saturation(trial, largest, rows):
            found.append(Fault(record.source, (name,), f"{whose} {text}", bent_um=trial.plain))
    return found


class _Trial(NamedTuple):
    """One output fitted as it is, with a trend in time, with a bend of the output, and with both.

    ``position`` is the output of the plain fit between its ends, from -1 to 1; ``reach`` is half of its range
    [um]. Each fit consists of its weights, the added ones last, and its rms error [um].
    """

    position: Array
    time: Array
    reach: float
    plain: float
    trend: tuple[Array, float]
    bend: tuple[Array, float]
    both: tuple[Array, float]

    @classmethod
    def of(cls, x: Array, y: Array) -> _Trial:
        """Fits of an output (sample,) by regressors (column, sample)."""
        n = len(x)
        weights, plain = Products.of(np.vstack([x, y])).fit(range(n), n)
        fit = weights @ x
        reach = max(0.5 * float(np.ptp(fit)), np.finfo(float).tiny)
        position = (fit - fit.min()) / reach - 1.0
        time = np.linspace(-1.0, 1.0, y.size)
        every = Products.of(np.vstack([x, time, time**2, position**2, position**3, y]))
        slow, bent = [*range(n), n, n + 1], [*range(n), n + 2, n + 3]
        fits = (every.fit(columns, n + 4) for columns in (slow, bent, range(n + 4)))
        return cls(position, time, reach, plain, *fits)


def _drift(trial: _Trial, largest_um: float) -> float:
    """How far a trend in time goes [um]; 0 if it explains little, or is little of the largest range."""
    slow, bent, both = trial.trend[1], trial.bend[1], trial.both[1]
    if slow >= DRIFT_EXPLAINS * trial.plain and both >= DRIFT_EXPLAINS * bent:
        return 0.0
    a, b = trial.trend[0][-2:] if slow < bent else trial.both[0][-4:-2]
    drift = float(np.ptp(a * trial.time + b * trial.time**2))
    return drift if drift > DRIFT * largest_um else 0.0


def _saturation(trial: _Trial, largest_um: float, rows: Indices) -> str:
    """Ends towards which the output moves less; empty if there are none, or the largest range hides it."""
    slow, bent, both = trial.trend[1], trial.bend[1], trial.both[1]
    bends = bent < BENT_EXPLAINS * trial.plain or both < BENT_EXPLAINS * slow
    if trial.plain <= BENT * largest_um or not bends:
        return ""
    z = trial.position
    c2, c3 = (trial.bend if bent < slow else trial.both)[0][-2:]
    slope = trial.reach + 2.0 * c2 * z + 3.0 * c3 * z**2
    steepest, ends = float(slope.max()), {"lowest": int(np.argmin(z)), "highest": int(np.argmax(z))}
    flat = {name: k for name, k in ends.items() if slope[k] < FLAT * steepest}
    if not flat or max(float(slope[k]) for k in ends.values()) >= STEEPER * steepest:
        return ""
    where = " and ".join(f"{name} readings (row {rows[k]})" for name, k in flat.items())
    return (
        f"saturates: towards its {where} its slope falls below {100.0 * FLAT:.0f} % of the steepest slope; "
        "lower the amplitude, or keep away from there"
    )


def _clipped_commands(record: Record, stride: int, blocks: dict[int, Array]) -> Iterator[Fault]:
    """Outputs that are constant while the command exceeds a limit, and move again when it returns."""
    readings = record.y_um[:, ::stride]
    x = np.vstack([*blocks.values(), np.ones((1, readings.shape[1]))])
    products = Products.of(np.vstack([x, readings]))
    weights = np.array([products.fit(range(len(x)), len(x) + o)[0] for o in range(len(readings))])
    size = np.maximum(readings.std(axis=1), np.finfo(float).tiny)  # outputs can have very different gains
    ends = np.cumsum([0, *map(len, blocks.values())])
    for k, first, stop in zip(blocks, ends, ends[1:], strict=False):
        u = record.u_v[k, ::stride]
        own = weights[:, first:stop] @ x[first:stop]
        o = int(np.argmax(own.std(axis=1) / size))
        others = np.r_[0:first, stop : len(x) - 1]
        y = readings[o] - weights[o, others] @ x[others]
        for side in (1.0, -1.0):
            level = _limit(side * u, side * y)
            if level is not None:
                yield _clipped(record, k, o, side, level)


def _clipped(record: Record, k: int, o: int, side: float, level: float) -> Fault:
    places = runs(side * record.u_v[k] > level)
    start, stop = max(places.tolist(), key=lambda place: place[1] - place[0])
    more = f" and {len(places) - 1} more places" if len(places) > 1 else ""
    name, moved = record.inputs[k], record.outputs[o]
    return Fault(
        record.source,
        record.outputs,
        f"{name} of {record.source} is clipped on its way to the actuator: {moved} is constant while "
        f"the command exceeds {record.rest_v[k] + side * level:.4g} V (rows {record.rows[start]} to "
        f"{record.rows[stop]}{more}); keep the command within the range of the amplifier, or record "
        "its output",
    )


def _limit(u: Array, y: Array) -> float | None:
    """Level above which a rising voltage moves the output no further, though it did right below it."""
    low, high = float(u.min()), float(u.max())
    span = high - low
    size = float((u - u.mean()) @ (u - u.mean()))
    gain = float((u - u.mean()) @ (y - y.mean())) / max(size, float(np.finfo(float).tiny))
    rising = np.diff(u, prepend=u[0]) > 0.0
    for part in TOP:
        level = low + part * span
        above, below = rising & (u > level), rising & (u <= level) & (u > level - 0.1 * span)
        top, under = _slope(u[above], y[above]), _slope(u[below], y[below])
        if top is None or under is None:
            continue
        slope, error = top
        stands = abs(slope) + 2.0 * error < STANDS * under[0]
        if stands and under[0] - 2.0 * under[1] > STEEP * gain > 0.0:
            limit = float(u[below].mean() + (y[above].mean() - y[below].mean()) / under[0])
            back = ~rising & (u <= limit) & (u > limit - 0.1 * span)
            again = _slope(u[back], y[back])
            follows = again is not None and again[0] > RETURNS * gain
            corner = rising & (np.abs(u - limit) < CORNER * span)
            reaches = corner.any() and y[above].mean() - y[corner].mean() < CORNER * np.ptp(y)
            sharp = follows and reaches and _sharp(u[rising], y[rising], limit, 0.1 * span)
            return limit if sharp else None
    return None


def _sharp(u: Array, y: Array, limit: float, width: float) -> bool:
    """Whether the output is as steep right below a limit as further down; towards saturation it is not."""
    near, before = (u > limit - width) & (u <= limit), (u > limit - 2.0 * width) & (u <= limit - width)
    slopes = _slope(u[near], y[near]), _slope(u[before], y[before])
    return slopes[0] is not None and slopes[1] is not None and slopes[0][0] > SHARP * slopes[1][0]


def _slope(u: Array, y: Array) -> tuple[float, float] | None:
    """Slope of an output over a voltage and its standard error; None for too few samples."""
    if u.size < FEWEST:
        return None
    v = u - u.mean()
    power = float(v @ v)
    if power == 0.0:
        return None
    slope = float(v @ (y - y.mean())) / power
    left = y - y.mean() - slope * v
    return slope, float(np.sqrt(left @ left / (u.size - 2) / power))


def _clipped_readings(record: Record) -> Iterator[Fault]:
    """Voltages that stand at their limit while an output rises and falls again: the reading is clipped."""
    for k in driven_inputs(record):
        u = record.u_v[k]
        for side in (1.0, -1.0):
            held = runs(side * u == (side * u).max()).tolist()
            places = [(a, b) for a, b in held if b - a + 1 >= LONG and _reached(u, a, b)]
            if not places:
                continue
            humps = np.array([hump(side * record.y_um[:, a : b + 1]) for a, b in places])
            spans = np.ptp(record.y_um, axis=1)
            o = int(np.argmax(spans))
            noise = noise_rms(record.y_um[o]) / np.sqrt(LONG / 4.0)
            tall = np.median(humps[:, o]) > max(HUMP * spans[o], SURE * noise)
            if tall and (humps[:, o] > 0.0).all():
                highest = int(np.argmax(humps[:, o]))
                start, stop = places[highest]
                name, moved, limit = record.inputs[k], record.outputs[o], record.rest_v[k] + u[start]
                yield Fault(
                    record.source,
                    (moved, *(other for other in record.outputs if other != moved)),
                    f"{name} of {record.source} is clipped by its recorder at {limit:.4g} V: {moved} "
                    f"still moves while it is constant (rows {record.rows[start]} to "
                    f"{record.rows[stop]}, {len(places)} such places); record it with a larger range",
                    hump_um=side * float(humps[highest, o]),
                    held=(int(start), int(stop)),
                )


def _reached(u: Array, start: int, stop: int) -> bool:
    """Whether a voltage went up to a limit and back from it, and did not jump."""
    before, behind = max(start - 1, 0), min(stop + 1, len(u) - 1)
    jump = max(abs(u[before] - u[start]), abs(u[behind] - u[stop]))
    return bool(jump < JUMP * np.ptp(u))


def hump(y: Array) -> Array:
    """Height of the middle of a part above both of its ends (output,); negative if above one only."""
    tenth = max(y.shape[1] // 8, 1)
    half = y.shape[1] // 2
    middle = y[:, half - tenth : half + tenth + 1].mean(axis=1)
    ends = y[:, :tenth].mean(axis=1), y[:, -tenth:].mean(axis=1)
    return np.asarray(np.minimum(middle - ends[0], middle - ends[1]))
