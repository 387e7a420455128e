"""Gain from each voltage to each output, which reveals wrong units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hammerstein.arrays import Array
from hammerstein.records.excitation import driven_inputs
from hammerstein.records.record import Record
from hammerstein.records.turning_points import turning_points

USUAL_GAIN = 1e-3, 1e3
"""Gains of piezo actuators from shear plates to amplified stages, with room on both sides [um/V]."""
SURE_GAIN, SURE_TRAVEL_UM = 50.0, 1000.0
"""Gain [um/V] and travel above which numbers without a unit are rather nm than um."""
ANSWERED = 0.02
"""Part of an output's power that the voltages explain, below which it is noise or another signal."""
SLOW_HZ, FINE = 100.0, 100
"""Converters run at 10 to 50 kHz; with times of 1000 times the size that is 10 to 50 Hz. A cycle of so many
samples asks for no rate as slow as that."""
FAST_HZ = 1e5
"""Faster than this no voltage that drives an actuator goes to and fro."""
JUMP = 0.25
"""Step of an output from one sample to the next, in parts of the largest range that is left without it, from
which it is a jump: of the stage in its mount, of a sensor, or where records were put together."""
SUDDEN = 4.0
"""How many times the usual large step of that output, and the largest of any voltage, it then is."""
USUAL = 0.98
"""Part of the steps that are no larger than the usual large one."""
SWING = 0.05
"""Part of the range that a voltage goes back where it turns."""


@dataclass(frozen=True)
class Gain:
    """Gain of one pair over all records.

    Parameters
    ----------
    input, output : names of the axes
    span_v : largest range of the voltage in one record [V]
    span_um : largest range of the output in one record in which the input is driven [um]
    um_per_v : least-squares gain, all inputs at once [um/V]
    """

    input: str
    output: str
    span_v: float
    span_um: float
    um_per_v: float


def pair_gains(records: Sequence[Record]) -> list[Gain]:
    """Gain of every pair of an input that is driven, pair by pair.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Examples
    --------
    >>> u = np.sin(np.linspace(0.0, 12.0, 300))
    >>> pair_gains([Record([u], [5.0 * u], 1e-3)])[0].um_per_v.__round__(9)
    5.0
    """
    first = records[0]
    power = np.zeros((len(first.u_v),) * 2)
    cross = np.zeros((len(first.y_um), len(first.u_v)))
    for record in records:
        u = record.u_v - record.u_v.mean(axis=1, keepdims=True)
        power += u @ u.T
        cross += (record.y_um - record.y_um.mean(axis=1, keepdims=True)) @ u.T
    size = np.sqrt(np.maximum(np.diag(power), np.finfo(float).tiny))
    gains = cross / size @ np.linalg.pinv(power / np.outer(size, size), rcond=1e-9, hermitian=True) / size
    spans_v = np.max([np.ptp(record.u_v, axis=1) for record in records], axis=0)
    spans_um: dict[int, Array] = {}
    for record in records:
        for k in driven_inputs(record):
            spans_um[k] = np.maximum(spans_um.get(k, 0.0), np.ptp(record.y_um, axis=1))
    return [
        Gain(first.inputs[k], output, float(spans_v[k]), float(spans_um[k][o]), float(gains[o, k]))
        for k in sorted(spans_um)
        for o, output in enumerate(first.outputs)
    ]


def doubtful_responses(records: Sequence[Record]) -> list[str]:
    """Sentences about records whose outputs are a copy of a voltage, or do not answer to any.

    An output answers where the voltages, their squares and their rates explain a part of it.

    Examples
    --------
    >>> u, noise = np.sin(np.arange(400.0) / 20.0), np.random.default_rng(1).normal(size=400)
    >>> doubtful_responses([Record([u], [5.0 * u], 1e-3)]), doubtful_responses([Record([u], [noise], 1e-3)])
    ([], ['no output of record responds to its voltages: they explain less than 2 % of each'])
    """
    found = []
    for record in records:
        copies = [
            f"{output} of {record.source} equals the column {name}"
            for name, u in zip(record.inputs, record.u_v, strict=True)
            for output, y in zip(record.outputs, record.y_um, strict=True)
            if np.ptp(y) > 0.0 and np.array_equal(u, y)
        ]
        found += copies
        if not copies and _explained(record) < ANSWERED:
            found.append(
                f"no output of {record.source} responds to its voltages: they explain less than "
                f"{100 * ANSWERED:g} % of each"
            )
    return found


def doubtful_jumps(records: Sequence[Record]) -> list[str]:
    """Sentences about outputs that jump while no voltage jumps.

    Examples
    --------
    >>> u = np.sin(np.arange(400.0) / 20.0)
    >>> moved = 5.0 * u + 500.0 * (np.arange(400) >= 250)
    >>> doubtful_jumps([Record([u], [5.0 * u], 1e-3)]), doubtful_jumps([Record([u], [moved], 1e-3)])
    ([], ['y1 of record jumps by 500.2 um at row 251, but no voltage jumps: cut the record there'])
    """
    found = []
    for record in records:
        steps = np.diff(record.y_um, axis=1)
        size = np.abs(steps)
        places = size.argmax(axis=1)
        jumps = size.max(axis=1)
        behind = np.arange(record.samples) > places[:, None]
        left = np.ptp(record.y_um - np.where(behind, steps[range(len(steps)), places, None], 0.0), axis=1)
        u = record.u_v[list(driven_inputs(record))]
        fastest = float(np.max(np.abs(np.diff(u, axis=1)).max(axis=1) / np.ptp(u, axis=1)))
        largest = max(JUMP, SUDDEN * fastest) * float(left.max())
        for o in np.flatnonzero((jumps > largest) & (jumps > SUDDEN * np.quantile(size, USUAL, axis=1))):
            found.append(
                f"{record.outputs[o]} of {record.source} jumps by {jumps[o]:.4g} um at row "
                f"{record.rows[places[o] + 1]}, but no voltage jumps: cut the record there"
            )
    return found


def doubtful_clocks(records: Sequence[Record]) -> list[str]:
    """Sentences about records whose times may be in another unit: sampled slowly and yet finely, or fast.

    Examples
    --------
    >>> u = np.sin(2.0 * np.pi * np.arange(4000.0) / 1000.0)
    >>> doubtful_clocks([Record([u], [5.0 * u], 1e-4)])
    []
    >>> doubtful_clocks([Record([u], [5.0 * u], 0.1)])[0].partition(". ")[0]
    'record: 10 Hz for 400 s, and the voltage turns 8 times'
    """
    found = []
    for record in records:
        rate_hz = 1.0 / record.sample_time_s
        driven = record.u_v[list(driven_inputs(record))]
        most = max(len(turning_points(u, SWING * float(np.ptp(u)))) for u in driven) - 2
        if rate_hz < SLOW_HZ and 2.0 * record.samples > FINE * most:
            found.append(
                f"{record.source}: {rate_hz:.4g} Hz for {record.samples / rate_hz:.4g} s, and the "
                f"voltage turns {most} times. If its times are in milliseconds, name their column t_ms"
            )
        if 0.5 * most * rate_hz / record.samples > FAST_HZ:
            found.append(
                f"{record.source}: the voltage turns {most} times within "
                f"{record.samples / rate_hz:.4g} s, too fast for an actuator. If its times are in "
                "seconds, name their column t_s"
            )
    return found


def _explained(record: Record) -> float:
    """Largest part of the power of an output that voltages, their squares and their rates explain."""
    u = record.u_v[list(driven_inputs(record))]
    u = (u - u.mean(axis=1, keepdims=True)) / np.ptp(u, axis=1, keepdims=True)
    x = np.vstack([u, u**2, np.gradient(u, axis=1), np.ones((1, u.shape[1]))]).T
    left = record.y_um.T - x @ np.linalg.lstsq(x, record.y_um.T, rcond=None)[0]
    power = np.maximum(record.y_um.var(axis=1), np.finfo(float).tiny)
    return float(np.max(1.0 - left.var(axis=0) / power))


def doubtful_gains(gains: Sequence[Gain]) -> list[str]:
    """Sentences about inputs whose strongest effect is none that an actuator has.

    Examples
    --------
    >>> doubtful_gains([Gain("u", "x", 100.0, 40.0, 0.4)])
    []
    >>> print(doubtful_gains([Gain("u", "x", 100.0, 4e5, 4e3)])[0])
    x moves by 4e+03 um/V (over 4e+05 um for 100 V of u), outside 0.001 to 1000 um/V
    """
    low, high = USUAL_GAIN
    return [
        f"{gain.output} moves by {gain.um_per_v:.3g} um/V (over {gain.span_um:.3g} um for "
        f"{gain.span_v:.3g} V of {gain.input}), outside {low:g} to {high:g} um/V"
        for gain in _strongest(gains)
        if not low <= abs(gain.um_per_v) <= high
    ]


def doubtful_units(gains: Sequence[Gain]) -> list[str]:
    """Sentences about outputs whose numbers, taken as um, are no travel of a piezo actuator.

    Examples
    --------
    >>> doubtful_units([Gain("u", "x", 100.0, 90.0, 0.9)])
    []
    >>> print(doubtful_units([Gain("u", "x", 100.0, 88000.0, 813.0)])[0])
    x has no unit; in um it would travel 88 mm, 813 um for each V of u
    >>> print(doubtful_units([Gain("u", "x", 100.0, 0.09, 0.0009)])[0])
    x has no unit; in um it would travel 0.09 um, 0.0009 um for each V of u
    """
    large = [gain for gain in gains if abs(gain.um_per_v) > SURE_GAIN or gain.span_um > SURE_TRAVEL_UM]
    small = [gain for gain in _strongest(gains) if abs(gain.um_per_v) < USUAL_GAIN[0]]
    return [
        f"{gain.output} has no unit; in um it would travel {_travel(gain.span_um)}, "
        f"{abs(gain.um_per_v):.3g} um for each V of {gain.input}"
        for gain in (*large, *small)
    ]


def _travel(um: float) -> str:
    return f"{1e-3 * um:.4g} mm" if um > SURE_TRAVEL_UM else f"{um:.3g} um"


def _strongest(gains: Sequence[Gain]) -> list[Gain]:
    """Strongest effect of each input."""
    found: dict[str, Gain] = {}
    for gain in gains:
        if abs(gain.um_per_v) >= abs(found.get(gain.input, gain).um_per_v):
            found[gain.input] = gain
    return list(found.values())
