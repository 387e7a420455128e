"""Gain from each voltage to each output, to detect wrong units."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array, Complex
from hammerstein.errors import Mistake, refuse
from hammerstein.quantities import by_key
from hammerstein.records.record import Record, driven_inputs
from hammerstein.records.turning_points import turning_points
from hammerstein.signals.text_tables import where

USUAL_GAIN = 1e-3, 1e3
"""Gains of piezo actuators from shear plates to amplified stages, with room on both sides [um/V]."""
SURE_GAIN, SURE_TRAVEL_UM = 50.0, 1000.0
"""Gain [um/V] and travel above which numbers without a unit are rather nm than um."""
LEAST_TRAVEL_UM = 0.5
"""Travel below which they are rather mm: most stages move 1 to 500 um."""
ANSWERED = 0.02
"""Part of an output's power that the voltages explain, below which it is noise or another signal."""
PAST, CHANCE, ROUNDING = 4, 4.0, 1e-9
"""Samples before that tell the next one, standard errors that are no chance, and power that is none."""
SLOW_HZ, FINE = 100.0, 100
"""Converters run at 10 to 50 kHz; with times of 1000 times the size that is 10 to 50 Hz. A cycle of so many
samples asks for no rate as slow as that."""
IN_US_HZ = 0.1
"""Slower than any record of a loop: with times in microseconds, converters run at 0.01 to 0.05 Hz."""
FAST_HZ = 1e5
"""Highest frequency of a drive voltage [Hz]."""
JUMP = 0.25
"""Step of an output from one sample to the next, in parts of the largest range that is left without it, from
which it is a jump: of the stage in its mount, of a sensor, or where records were put together."""
SUDDEN = 4.0
"""How many times the usual large step of that output, and the largest of any voltage, it then is."""
USUAL = 0.98
"""Part of the steps that are no larger than the usual large one."""
CROSSED = 2.0
"""Gain of the strongest input of an output over that of its own, from which columns may be exchanged."""
SWING = 0.05
"""Part of the range that a voltage goes back where it turns."""


class Gain(NamedTuple):
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


def doubtful_responses(records: Sequence[Record]) -> Iterator[str]:
    """Sentences about records whose outputs are a copy of a voltage, or do not respond to any.

    An output answers where the voltages, their squares and their rates explain a part of it, or the last
    voltages a part of what its own last samples leave.

    Examples
    --------
    >>> u, noise = np.sin(np.arange(400.0) / 20.0), np.random.default_rng(1).normal(size=400)
    >>> list(doubtful_responses([Record([u], [5.0 * u], 1e-3)]))
    []
    >>> list(doubtful_responses([Record([u], [noise], 1e-3)]))
    ['no output of record responds to its voltages: they explain less than 2 % of each']
    """
    for record in records:
        copies = [
            f"{output} of {record.source} equals the column {name}"
            for name, u in zip(record.inputs, record.u_v, strict=True)
            for output, y in zip(record.outputs, record.y_um, strict=True)
            if np.ptp(y) > 0.0 and np.array_equal(u, y)
        ]
        yield from copies
        if not copies and not _answers(record):
            yield (
                f"no output of {record.source} responds to its voltages: they explain less than "
                f"{100 * ANSWERED:g} % of each"
            )


def doubtful_jumps(records: Sequence[Record]) -> Iterator[str]:
    """Sentences about outputs that jump while no voltage jumps.

    Examples
    --------
    >>> u = np.sin(np.arange(400.0) / 20.0)
    >>> moved = 5.0 * u + 500.0 * (np.arange(400) >= 250)
    >>> list(doubtful_jumps([Record([u], [5.0 * u], 1e-3)]))
    []
    >>> list(doubtful_jumps([Record([u], [moved], 1e-3)]))
    ['y1 of record jumps by 500.2 um at row 251, but no voltage jumps: cut the record there']
    """
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
            yield (
                f"{record.outputs[o]} of {record.source} jumps by {jumps[o]:.4g} um at row "
                f"{record.rows[places[o] + 1]}, but no voltage jumps: cut the record there"
            )


def doubtful_clocks(records: Sequence[Record]) -> Iterator[str]:
    """Sentences about records whose times may be in another unit: too slow for their density, or too fast.

    Examples
    --------
    >>> u = np.sin(2.0 * np.pi * np.arange(4000.0) / 1000.0)
    >>> list(doubtful_clocks([Record([u], [5.0 * u], 1e-4)]))
    []
    >>> next(doubtful_clocks([Record([u], [5.0 * u], 0.1)])).partition(". ")[0]
    'record: 10 Hz for 400 s, and the voltage turns 8 times'
    """
    for record in records:
        rate_hz = 1.0 / record.sample_time_s
        driven = record.u_v[list(driven_inputs(record))]
        most = max(len(turning_points(u, SWING * float(np.ptp(u)))) for u in driven) - 2
        unit, name = ("microseconds", "t_us") if rate_hz < IN_US_HZ else ("milliseconds", "t_ms")
        if rate_hz < IN_US_HZ or (rate_hz < SLOW_HZ and 2.0 * record.samples > FINE * most):
            yield (
                f"{record.source}: {rate_hz:.4g} Hz for {record.samples / rate_hz:.4g} s, and the "
                f"voltage turns {most} times. If its times are in {unit}, name their column {name}"
            )
        if 0.5 * most * rate_hz / record.samples > FAST_HZ:
            yield (
                f"{record.source}: the voltage turns {most} times within "
                f"{record.samples / rate_hz:.4g} s, too fast for an actuator. If its times are in "
                "seconds, name their column t_s"
            )


def _answers(record: Record) -> bool:
    """Whether voltages, their squares and their rates explain a part of an output, or of its next sample.

    Beyond a resonance an output hardly resembles the voltage. But the last voltages explain what its own
    last samples do not.
    """
    u = record.u_v[list(driven_inputs(record))]
    u = (u - u.mean(axis=1, keepdims=True)) / np.ptp(u, axis=1, keepdims=True)
    one, at_once = np.ones((1, record.samples)), [u, u**2, np.gradient(u, axis=1)]
    outputs = [y - y.mean() for y in record.y_um if np.ptp(y) > 0.0]
    if any(_explain(y, [one], at_once) for y in outputs):
        return True
    last = [_late(u, k) for k in range(PAST + 1)]
    return any(_explain(y, [one, *(_late(y[None], k + 1) for k in range(PAST))], last) for y in outputs)


def _late(rows: Array, samples: int) -> Array:
    return rows[:, np.maximum(np.arange(rows.shape[1]) - samples, 0)]


def _explain(y: Array, known: Sequence[Array], more: Sequence[Array]) -> bool:
    """Whether further rows explain a part of an output that known ones leave, by more than chance does.

    Of n samples of white noise, p rows explain (p / n) F, and F = 1 +- sqrt(2 / p + 2 / n).
    """
    p = sum(map(len, more))
    n = max(len(y) - p - sum(map(len, known)), 1)
    squares = []
    for rows in (known, [*known, *more]):
        x = np.vstack(rows).T
        squares.append(float(np.mean((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2)))
    chance = (1.0 + CHANCE * math.sqrt(2.0 / p + 2.0 / n)) * p / n
    return squares[0] - squares[1] > (ANSWERED + chance) * (squares[1] + ROUNDING * float(y.var()))


def doubtful_gains(gains: Sequence[Gain]) -> list[str]:
    """Sentences about inputs whose strongest gain is implausible for an actuator.

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
    """Sentences about outputs with an implausible travel for a piezo actuator in um.

    Examples
    --------
    >>> doubtful_units([Gain("u", "x", 100.0, 90.0, 0.9)])
    []
    >>> print(doubtful_units([Gain("u", "x", 100.0, 88000.0, 813.0)])[0])
    x has no unit; in um it would travel 88 mm, 813 um for each V of u
    >>> print(doubtful_units([Gain("u", "x", 10.0, 0.09, 0.009)])[0])
    x has no unit; in um it would travel 0.09 um, 0.009 um for each V of u
    """
    large = [gain for gain in gains if abs(gain.um_per_v) > SURE_GAIN or gain.span_um > SURE_TRAVEL_UM]
    small = [g for g in _strongest(gains) if abs(g.um_per_v) < USUAL_GAIN[0] or g.span_um < LEAST_TRAVEL_UM]
    return [
        f"{gain.output} has no unit; in um it would travel {_travel(gain.span_um)}, "
        f"{abs(gain.um_per_v):.3g} um for each V of {gain.input}"
        for gain in (*large, *small)
    ]


def _travel(um: float) -> str:
    return f"{1e-3 * um:.4g} mm" if um > SURE_TRAVEL_UM else f"{um:.3g} um"


def doubtful_order(gains: Sequence[Gain]) -> list[str]:
    """A sentence if every output follows the input of another one, so that columns may be exchanged.

    Examples
    --------
    >>> crossed = [("u", "x", 0.3), ("u", "y", 5.0), ("v", "x", 6.0), ("v", "y", 0.2)]
    >>> print(doubtful_order([Gain(u, y, 20.0, 100.0, gain) for u, y, gain in crossed])[0])
    x follows v (6 um/V; 0.3 um/V with u), y follows u (5 um/V; 0.2 um/V with v)
    """
    inputs = list(dict.fromkeys(gain.input for gain in gains))
    outputs = list(dict.fromkeys(gain.output for gain in gains))
    if len(inputs) != len(outputs) or len(gains) != len(inputs) ** 2:
        return []
    size = {(gain.input, gain.output): gain.um_per_v for gain in gains}
    found = {y: max(inputs, key=lambda u: abs(size[u, y])) for y in outputs}
    each = list(zip(inputs, outputs, strict=True))
    own = [CROSSED * abs(size[u, y]) < abs(size[found[y], y]) for u, y in each]
    if not all(own) or len(set(found.values())) < len(outputs):
        return []
    words = (
        f"{y} follows {found[y]} ({size[found[y], y]:.3g} um/V; {size[u, y]:.3g} um/V with {u})"
        for u, y in each
    )
    return [", ".join(words)]


def _strongest(gains: Sequence[Gain]) -> list[Gain]:
    """Strongest effect of each input."""
    each = by_key(gains, lambda gain: gain.input).values()
    return [max(reversed(own), key=lambda gain: abs(gain.um_per_v)) for own in each]


ALIKE = 0.5
"""Correlation of output and input from which a lead has a meaning."""
COHERENT = 1e3
"""Condition of the inputs' power from which they are one and the same."""
LEAD_RAD = -0.03  # an output that leads by more is a voltage, or its columns are swapped
FARTHEST_LEAD_RAD = -0.8
"""A lead beyond this is no swapped loop but a lag of more than half a turn."""


def lag_rad(records: Sequence[Record]) -> Array:
    """Phase lag of each output behind each input [rad], over the slower half of the excitation.

    The angle of the response S_yu S_uu^-1, for a gain of either sign: between -pi/2 and pi/2. Both spectra
    are summed over all records, and over the lines with the slower half of the inputs' power. A hysteresis
    loop of 15 percent width lags by about 0.15 rad; an output that *leads* by as much is really a voltage.
    Solving for all inputs at once separates their contributions.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Returns
    -------
    (output, input) phases [rad]; 0 for inputs that are driven in no record
    """
    response, _ = _response(records)
    sign = np.where(response.real < 0, -1.0, 1.0)
    return np.asarray(np.arctan2(-sign * response.imag, np.abs(response.real)))


def _response(records: Sequence[Record], share: float = 0.5) -> tuple[Complex, bool]:
    """Response (output, input) over the slower lines that hold a share of the inputs' power.

    Also whether inputs can be told apart.
    """
    driven = sorted({k for record in records for k in driven_inputs(record)})
    size = np.sqrt(sum(record.u_v[driven].var(axis=1) * record.samples for record in records))
    p = len(records[0].y_um)
    power = np.zeros((len(driven), len(driven)), dtype=np.complex128)
    cross = np.zeros((p, len(driven)), dtype=np.complex128)
    for record in records:
        u = _spectra(record.u_v[driven]) / size[:, None]
        energy = np.cumsum((np.abs(u) ** 2).sum(axis=0))
        lines = slice(0, int(np.searchsorted(energy, share * energy[-1])) + 2)
        power += u[:, lines] @ u[:, lines].conj().T
        cross += _spectra(record.y_um)[:, lines] @ u[:, lines].conj().T
    response = np.zeros((p, len(records[0].u_v)), dtype=np.complex128)
    response[:, driven] = cross @ np.linalg.pinv(power, rcond=1.0 / COHERENT, hermitian=True) / size
    return response, bool(np.linalg.cond(power) < COHERENT)


def _spectra(signals: Array) -> Complex:
    window = np.hanning(signals.shape[1])
    return np.asarray(np.fft.rfft(window * (signals - signals.mean(axis=1, keepdims=True))))


def _unit(signals: Array) -> Array:
    """Signals (axis, sample) about their means, of length 1; zero where one stands still."""
    centred = signals - signals.mean(axis=1, keepdims=True)
    return np.asarray(centred / np.maximum(np.linalg.norm(centred, axis=1, keepdims=True), 1e-300))


def leads(records: Sequence[Record]) -> tuple[tuple[int, int], ...]:
    """Pairs (output, input) in which the output leads the input, as with swapped columns.

    Only the output that responds most to an input counts, and only a lead of 0.03 to 0.8 rad at a positive
    gain: a larger lead looks like the lag of a resonance. The output must also lead over the whole excited
    band, weighted by power, so that a weak slow line does not outweigh a strong line that lags. An output
    that hardly resembles the input, such as a butterfly, does not count. If the inputs cannot be separated
    (one circle), a cross-coupling looks like a lead on one axis; then all outputs must lead.

    Parameters
    ----------
    records : voltages and displacements of one actuator

    Examples
    --------
    >>> from hammerstein.hysteresis import play
    >>> u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    >>> x = 5.0 * play(u, [2.0])
    >>> leads([Record([u], x, 5e-5)]), leads([Record(x, [u], 5e-5)])
    ((), ((0, 0),))
    """
    (response, apart), lag = _response(records), lag_rad(records)
    driven = [driven_inputs(record) for record in records]
    alike = [np.abs(_unit(record.y_um) @ _unit(record.u_v).T) for record in records]
    moved = np.sqrt(sum(record.y_um.var(axis=1) * record.samples for record in records))
    (whole, _), found, asked = _response(records, 1.0), [], {k for inputs in driven for k in inputs}
    for k in sorted(asked):
        o = int(np.argmax(np.abs(response[:, k]) / np.maximum(moved, np.finfo(float).tiny)))
        correlation = max(a[o, k] for a, inputs in zip(alike, driven, strict=True) if k in inputs)
        ahead = FARTHEST_LEAD_RAD < lag[o, k] < LEAD_RAD and whole[o, k].imag > 0.0
        if ahead and response[o, k].real > 0 and correlation > ALIKE:
            found.append((o, k))
    return tuple(found) if apart or len(found) == len(asked) else ()


def refuse_swapped(records: Sequence[Record]) -> None:
    """Refuse records whose outputs lead their inputs.

    Raises
    ------
    InputError : naming the columns that seem to be swapped
    """
    lag, first = lag_rad(records), records[0]
    mistakes = [
        Mistake(
            where(first.outputs[o], first.rows, 0, first.samples - 1),
            f"leads {first.inputs[k]} by {-np.degrees(lag[o, k]):.1f} degrees, which is impossible "
            "for an actuator; are input and output columns swapped? If they are not, give "
            "--accept-order",
        )
        for o, k in leads(records)
    ]
    refuse(first.source if len(records) == 1 else f"{len(records)} records", mistakes)
