"""Hysteresis loops in measured records: size, width, area, closure, drift, and settling.

A loop runs from one turning point of a voltage to the next but one. Its lines are found on the voltage,
which is commanded and clean, so that sensor noise opens no loop and closes none.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.quantities import by_key
from hammerstein.records.record import Record, driven_alone, driven_inputs
from hammerstein.records.turning_points import Excursion, find_cycles, noise_rms, quantum

SMOOTHED = 10
"""Most samples on each side that a noisy output is smoothed over."""
AROUND_TIP = 5
"""Most samples on each side of a tip that its closure is averaged over."""
CLEAN = 1e-4
"""Noise, in parts of the range, up to which nothing is smoothed."""
JUMP = 0.1
"""Part of the swing at both ends in which a sample is part of no branch."""
GRID = 64
"""Voltages on each branch at which two cycles are compared."""
SETTLED_SHARE = 0.005
"""Part of the height by which a settled cycle may differ from its neighbour, beside the noise."""
LONE_SHARE = 0.1
"""Part of the height up to which noise may hide the closure of a cycle that nothing repeats."""
WIDE = 0.6
"""Part of the largest amplitude from which a loop is a wide one."""
SLOW = 0.05
"""Part of the time of the longest wide loop that another takes: one of a multisine is chance."""
SAME_SWING = 0.01
"""Part by which the swings of two cycles of one amplitude may differ."""
SAME_PACE = 0.1
"""Part by which the times of two cycles of one rate may differ: noise moves the turns."""
CLEAR = 3.0
"""Noise, times this, by which an output must fall for its gain to be negative."""
BACKWARDS_PERCENT = -5.0
"""Width from which a loop turns the other way: bent branches and noise make small negative widths."""
SWINGS, RINGS_SHARE = 8, 0.002
"""Crossings of its bend on each branch, by so much in parts of the height, from which an output rings."""
FINE = 8
"""Lines of a spectrum for each that the length of a branch resolves: its peak lies between them."""
ONE_WAY = 1.05
"""Way of the voltage on a branch, in parts of its swing, up to which no minor loop is on it."""
SETTLED_NOISE = 3.0
"""And the noise, times this: the rms difference of two equal cycles is 1.4 times the noise."""


@dataclass(frozen=True)
class Loop:
    """One loop of one pair of axes.

    Parameters
    ----------
    input, output : names of the axes
    start, turn, stop : samples at which it starts, turns and closes
    minor : whether it is inside a larger loop
    amplitude_v : half the swing of the voltage [V]
    mid_v : voltage in the middle of the swing [V]
    height_um : peak to peak of the output [um]
    width_um : opening at mid_v [um]: falling minus rising branch where the output rises with the voltage,
        the other way round where it falls; positive when the output lags
    area_v_um : area inside, in shoelace form [V um]; positive when the output lags
    closure_um : output at the end minus at the start [um], at the voltage of the start
    drift_um : mean rise of the output to the next cycle of this amplitude [um], or from the one before;
        the closure where there is neither
    settled : whether it repeats in a neighbouring cycle within the noise; where no neighbour has its
        amplitude, whether voltage and output are closed, by more than the noise could hide

    Notes
    -----
    The width in percent is 100 h / H of the paper (section 5.2): the opening at mid voltage over the height.
    """

    input: str
    output: str
    start: int
    turn: int
    stop: int
    minor: bool
    amplitude_v: float
    mid_v: float
    height_um: float
    width_um: float
    area_v_um: float
    closure_um: float
    drift_um: float
    settled: bool

    @property
    def width_percent(self) -> float:
        """Opening at mid voltage in percent of the height; 0 for a loop without height."""
        return 100.0 * self.width_um / self.height_um if self.height_um > 0 else 0.0

    @property
    def samples(self) -> int:
        """Number of samples from start to stop."""
        return self.stop - self.start


class _Path(NamedTuple):
    """One excursion of a pair, minor loops left out.

    ``tips`` are voltage and output at the start, then at the stop, averaged over the samples around them;
    ``noise`` is that of the output [um].
    """

    excursion: Excursion
    u: Array
    y: Array
    turn: int
    tips: tuple[float, float, float, float]
    noise: float


def loop_table(record: Record) -> list[Loop]:
    """All loops of a record, pair by pair (inputs that are driven, every output), in the order of time.

    Only cycles in which a single input moves are loops of a pair: if two move, it is unknown which of them
    the output follows. The signals may be sines, triangles, modulated amplitudes or nested loops of unknown
    period. The first branch from rest belongs to no loop. A record without a whole cycle gives an empty list.

    Parameters
    ----------
    record : voltages and displacements

    Examples
    --------
    >>> from hammerstein.hysteresis import play
    >>> u = 10.0 * np.sin(2.0 * np.pi * np.arange(1200) / 400)
    >>> loops = loop_table(Record([u], 5.0 * play(u, [2.0]), 5e-5))
    >>> len(loops), loops[0].settled, round(loops[0].height_um, 3), round(loops[0].area_v_um, 1)
    (2, True, 80.0, 320.0)
    """
    return [
        loop
        for k in driven_inputs(record)
        if widest_cycle([record], k) is not None
        for o in range(len(record.y_um))
        for loop in pair_loops(record, k, o)
        if driven_alone(record, k, loop.start, loop.stop)
    ]


def telling_loops(loops: Sequence[Loop], most: int | None = None) -> list[Loop]:
    """Loops for a table, in order of time: of each pair the settled ones, or else the widest.

    The hundreds of excursions of a multisine are neither, and small ones that turn backwards are resonances.

    Parameters
    ----------
    loops : of one record
    most : of each pair, wide and late ones first; None: all of them

    Examples
    --------
    >>> from hammerstein.hysteresis import play
    >>> u = np.sin(2.0 * np.pi * np.arange(2000) / 400) * np.repeat([10.0, 3.0], [1200, 800])
    >>> loops = loop_table(Record([u], 5.0 * play(u, [2.0]), 5e-5))
    >>> len(loops), [loop.start for loop in telling_loops(loops, most=1)]
    (4, [500])
    """
    kept: set[int] = set()
    for own in by_key(loops, lambda loop: (loop.input, loop.output)).values():
        widest = max(loop.amplitude_v for loop in own)
        least = SLOW * max(loop.samples for loop in own if loop.amplitude_v >= WIDE * widest)
        slow = [
            loop
            for loop in own
            if loop.samples >= least
            and (loop.amplitude_v >= WIDE * widest or loop.width_percent > BACKWARDS_PERCENT)
        ]
        telling = [loop for loop in slow if loop.settled] or [
            loop for loop in slow if loop.amplitude_v >= WIDE * widest
        ]
        telling.sort(key=lambda loop: (-loop.amplitude_v, -loop.start))
        kept |= {id(loop) for loop in telling[:most]}
    return [loop for loop in loops if id(loop) in kept]


def turned_backwards(loops: Sequence[Loop]) -> str | None:
    """Reason why the widths of a record are no hysteresis, if its loops turn the wrong way; else None.

    An actuator's output lags. A settled loop in which it seems to lead is one of swapped columns, or one that
    was driven so fast that the output lags by more than half a turn. Of each input only the output that it
    moves most is judged.

    Parameters
    ----------
    loops : of one record

    Examples
    --------
    >>> turned = 2.0 * np.pi * np.arange(1200) / 400
    >>> late = Record([10.0 * np.sin(turned)], [np.sin(turned - np.radians(305.0))], 5e-5)
    >>> print(turned_backwards(loop_table(late))[:58])
    y1 and u1: the loop runs backwards (width -82 %). The outp
    """
    settled = [loop for loop in telling_loops(loops) if loop.settled]
    for name in dict.fromkeys(loop.input for loop in settled):
        largest = max((loop for loop in settled if loop.input == name), key=lambda loop: loop.height_um)
        if largest.width_percent < BACKWARDS_PERCENT and largest.area_v_um < 0:
            return (
                f"{largest.output} and {name}: the loop runs backwards (width "
                f"{largest.width_percent:.0f} %). The output leads, or lags by more than half a "
                "period: the width is not hysteresis. Use a lower frequency, or swap the columns"
            )
    return None


def ringing(record: Record, loops: Sequence[Loop]) -> str | None:
    """Reason why the widths of a record include more than hysteresis, if an output rings; else None.

    Between two turns of the voltage, hysteresis bends an output once. One that swings about such a bend many
    times rings: at the mid voltage, the loop is as wide as the ringing happens to be there. Of each input
    only the output that it moves most is judged.

    Examples
    --------
    >>> u = np.abs(np.arange(-1000, 1001) % 1000 - 500.0)
    >>> ringing(Record([u], [u + 5.0 * np.sin(u)], 1e-3), loop_table(Record([u], [u], 1e-3)))[:40]
    'y1 and u1: the output rings near 159 Hz '
    """
    for name, own in by_key(telling_loops(loops), lambda loop: loop.input).items():
        largest = max(own, key=lambda loop: loop.height_um)
        u, y = record.u_v[record.inputs.index(name)], record.y_um[record.outputs.index(largest.output)]
        parts = [slice(largest.start, largest.turn + 1), slice(largest.turn, largest.stop + 1)]
        branches = [y[part] for part in parts if np.abs(np.diff(u[part])).sum() < ONE_WAY * np.ptp(u[part])]
        swings = [branch - _bend(branch) for branch in branches if len(branch) > SWINGS]
        least = max(CLEAR * noise_rms(y), RINGS_SHARE * largest.height_um)
        turns = sum(len(_crossings(swing, least)) for swing in swings)
        if swings and turns >= SWINGS * len(swings):
            swing = max(swings, key=np.std)
            size, fast, fine = float(swing.std()), np.diff(swing), FINE * len(swing)
            lines = np.abs(np.fft.rfft(fast * np.hanning(len(fast)), fine))
            hertz = np.argmax(lines) / (fine * record.sample_time_s)
            return (
                f"{largest.output} and {name}: the output rings near {hertz:.3g} Hz ({size:.2g} um rms): "
                "widths and areas include it. Use a lower frequency, or sines in place of triangles"
            )
    return None


def _crossings(swing: Array, least: float) -> Indices:
    """Samples at which a swing is beyond a size again, on the other side."""
    beyond = np.flatnonzero(np.abs(swing) > least)
    return beyond[1:][np.diff(np.signbit(swing[beyond]))]


def _bend(branch: Array) -> Array:
    """The cubic that is nearest to a branch."""
    x = np.linspace(-1.0, 1.0, len(branch))
    return np.polynomial.Polynomial.fit(x, branch, 3)(x)


def widest_cycle(records: Sequence[Record], k: int, alone: bool = True) -> tuple[int, slice] | None:
    """Number of a record and its cycle of largest swing of an input, the last of the slowest ones.

    Where they are wide, cycles that close go before those that do not, and plain ones before those with turns
    in them: a multisine has the largest swing by chance, and closes by chance.

    Parameters
    ----------
    records : of one actuator
    k : input, from 0
    alone : whether the other inputs must rest meanwhile
    """
    found = [one for i, record in enumerate(records) for one in _cycles(i, record, k, alone)]
    if not found:
        return None
    widest = max(one.swing_v for one in found)
    best = max(one.merits for one in found if one.swing_v >= WIDE * widest)
    found = [one for one in found if one.swing_v >= WIDE * widest and one.merits == best]
    widest = max(one.swing_v for one in found)
    found = [one for one in found if one.swing_v >= (1.0 - SAME_SWING) * widest]
    slowest = max(one.seconds for one in found)
    last = [one for one in found if one.seconds >= (1.0 - SAME_PACE) * slowest][-1]
    return last.record, last.part


class _Cycle(NamedTuple):
    """merits : whether it is no minor loop, closes, and has no turns in it."""

    record: int
    part: slice
    swing_v: float
    seconds: float
    merits: tuple[bool, bool, bool]


def _cycles(i: int, record: Record, k: int, alone: bool) -> Iterator[_Cycle]:
    """Excursions of a driven input, for a choice among those of several records."""
    if k not in driven_inputs(record):
        return
    u, time_s = record.u_v[k], record.sample_time_s
    cycles = find_cycles(u)
    for e in cycles.excursions:
        if not alone or driven_alone(record, k, e.start, e.stop):
            inside = np.searchsorted(cycles.points, e.stop) - np.searchsorted(cycles.points, e.start, "right")
            part = slice(e.start, e.stop + 1)
            merits = (not e.minor, _closed(u, e), bool(inside <= 1))
            yield _Cycle(i, part, float(np.ptp(u[part])), (e.stop - e.start) * time_s, merits)


def _closed(u: Array, cycle: Excursion) -> bool:
    """Whether the voltage ends where it began: the last cycle before another signal does not."""
    return bool(np.ptp(u[[cycle.start, cycle.stop]]) <= SAME_SWING * np.ptp(u[cycle.start : cycle.stop + 1]))


def move_at_once(record: Record) -> bool:
    """Whether several inputs move without a cycle of one alone, so that no loop belongs to a single pair."""
    driven = driven_inputs(record)
    return len(driven) > 1 and not any(widest_cycle([record], k) for k in driven)


def without_loops(record: Record) -> str:
    """Reason why a record has no loop, as a sentence with a remedy."""
    driven = [record.inputs[k] for k in driven_inputs(record)]
    if len(driven) > 1:
        return (
            f"no loop of a pair: {' and '.join(driven)} move together; drive one input at a time, or let "
            "hammerstein identify separate them"
        )
    if find_cycles(record.u_v[driven_inputs(record)[0]]).excursions:
        return f"no loop found: {driven[0]} jumps between its levels; drive it with sines or triangles"
    return "no loop found: a voltage must turn twice; record two periods or more"


def pair_loops(record: Record, input_index: int, output_index: int) -> list[Loop]:
    """Loops of one input and one output, both counted from 0."""
    u, y = record.u_v[input_index], record.y_um[output_index]
    cycles = find_cycles(u)
    noise = max(noise_rms(y), 0.3 * quantum(y))  # rms error of rounding: 0.29 steps
    noise = noise if noise > CLEAN * float(np.ptp(y)) else 0.0
    minor = [excursion for excursion in cycles.excursions if excursion.minor]
    paths = [_path(u, y, excursion, minor, noise) for excursion in cycles.excursions if _drawn(u, excursion)]
    loops = [_measured(path, record.inputs[input_index], record.outputs[output_index]) for path in paths]
    return [_compared(k, loops, paths, cycles.band_v) for k in range(len(loops))]


def _drawn(u: Array, excursion: Excursion) -> bool:
    """Whether both branches have a sample between their ends: a voltage that jumps draws no loop."""
    start, turn, stop, _ = excursion
    low, high = sorted((float(u[start]), float(u[turn])))
    inner = (u > low + JUMP * (high - low)) & (u < high - JUMP * (high - low))
    return bool(inner[start:turn].any() and inner[turn : stop + 1].any())


def _path(u: Array, y: Array, excursion: Excursion, minor: Sequence[Excursion], noise: float) -> _Path:
    start, _, stop, _ = excursion
    kept = np.ones(stop - start + 1, dtype=bool)
    for other in minor:
        if start < other.start and other.stop <= stop:
            kept[other.start + 1 - start : other.stop - start] = False
    samples = np.flatnonzero(kept) + start
    turn = int(np.searchsorted(samples, excursion.turn))
    # a few samples around both ends alike: less noise, and what the corner adds is the same at both
    noisy = noise > 0.0 and not excursion.minor
    reach = min(len(samples) // 200, AROUND_TIP, start, len(u) - 1 - stop) if noisy else 0
    around = [slice(tip - reach, tip + reach + 1) for tip in (start, stop)]
    u_start, y_start, u_stop, y_stop = (float(signal[near].mean()) for near in around for signal in (u, y))
    return _Path(excursion, u[samples], y[samples], turn, (u_start, y_start, u_stop, y_stop), noise)


def _measured(path: _Path, input_name: str, output_name: str) -> Loop:
    """Everything that a loop tells without its neighbours."""
    u, y = path.u, path.y
    smooth = np.concatenate([_smooth(y[: path.turn], path.noise), _smooth(y[path.turn :], path.noise)])
    low, high = float(u.min()), float(u.max())
    mid = 0.5 * (low + high)
    first, second = slice(0, path.turn + 1), slice(path.turn, None)
    rising, falling = (second, first) if u[path.turn] < u[0] else (first, second)
    width = _at(u[falling], y[falling], mid, path.noise) - _at(u[rising], y[rising], mid, path.noise)
    sign = _sign(u, y, path)
    u_start, y_start, u_stop, y_stop = path.tips
    v, x = u - u[0], y - y[0]  # smaller numbers, smaller rounding errors
    closure = y_stop - y_start + _end_slope(u, smooth, path.turn) * (u_start - u_stop)
    return Loop(
        input=input_name,
        output=output_name,
        **path.excursion._asdict(),
        amplitude_v=0.5 * (high - low),
        mid_v=mid,
        height_um=float(np.ptp(smooth)),
        width_um=sign * width,
        area_v_um=sign * 0.5 * float(v[:-1] @ x[1:] - v[1:] @ x[:-1]),  # shoelace formula, its ends joined
        closure_um=closure,
        drift_um=closure,
        settled=False,
    )


def _sign(u: Array, y: Array, path: _Path) -> float:
    """Direction in which the output moves: -1 where it falls with the voltage."""
    rise = (y[path.turn] - 0.5 * (y[0] + y[-1])) * np.sign(u[path.turn] - u[0])
    return -1.0 if rise < -CLEAR * path.noise else 1.0


def _smooth(y: Array, noise: float) -> Array:
    """One branch without noise: local parabolas, one-sided at the tips, for the branch has corners there."""
    half = min(len(y) // 40, SMOOTHED)
    if half < 2 or noise <= CLEAN * float(np.ptp(y)):
        return y
    fit = _local_parabola(half)
    begin, end = fit[:half] @ y[: len(fit)], fit[half + 1 :] @ y[-len(fit) :]
    return np.concatenate([begin, np.convolve(y, fit[half][::-1], mode="valid"), end])


@cache
def _local_parabola(half: int) -> Array:
    """Matrix that turns 2 half + 1 samples into their least-squares parabola (Savitzky and Golay, 1964)."""
    powers = np.vander(np.linspace(-1.0, 1.0, 2 * half + 1), 3)
    return powers @ np.linalg.pinv(powers)


def _at(u: Array, y: Array, level_v: float, noise: float) -> float:
    """Output of a branch at a voltage: between two samples, or from a parabola through many noisy ones."""
    swing = abs(float(u[-1] - u[0]))
    near = np.abs(u - level_v) <= 0.075 * swing
    if noise > CLEAN * float(np.ptp(y)) and np.count_nonzero(near) >= 8:
        centred = (u[near] - level_v) / swing
        return float(np.linalg.lstsq(np.vander(centred, 3), y[near], rcond=None)[0][-1])
    return float(np.interp(level_v, *_increasing(u, y)))


def _increasing(u: Array, y: Array) -> tuple[Array, Array]:
    """A branch in the order of its voltage; voltages that step back in the noise are held."""
    if u[-1] < u[0]:
        u, y = u[::-1], y[::-1]
    return np.maximum.accumulate(u), y


def _end_slope(u: Array, y: Array, turn: int) -> float:
    """Slope of the last branch [um/V] over the last tenth of its swing, towards its end."""
    swing = float(u[-1] - u[turn])
    back = turn + int(np.argmax(np.abs(u[turn:] - u[-1]) <= 0.1 * abs(swing)))
    run = float(u[-1] - u[back])
    return float(y[-1] - y[back]) / run if abs(run) > 0.02 * abs(swing) else 0.0


def _compared(k: int, loops: Sequence[Loop], paths: Sequence[_Path], band_v: float) -> Loop:
    """Drift and settling, from the next cycle of the same amplitude or, failing that, the one before."""
    loop, path = loops[k], paths[k]
    limit = SETTLED_NOISE * path.noise + SETTLED_SHARE * loop.height_um
    steps = np.abs(np.diff(path.u))[[0, path.turn - 1, path.turn, -1]]  # sampling may cut off half a step
    same_v = max(band_v, SETTLED_SHARE * loop.amplitude_v, 0.5 * float(steps.max()))
    for others, sign in ((range(k + 1, len(loops)), 1.0), (range(k - 1, -1, -1), -1.0)):
        other = next((i for i in others if loops[i].minor == loop.minor), None)
        if other is None:
            continue
        ends = ((0, 0), (path.turn, paths[other].turn), (-1, -1))  # where both start, turn and stop
        apart_v = max(abs(float(path.u[i] - paths[other].u[j])) for i, j in ends)
        if apart_v <= same_v:
            # where samples miss the tips, voltages differ a little: twice the mean slope of that is no drift
            explained = apart_v * loop.height_um / loop.amplitude_v
            if sign < 0.0 and abs(loop.closure_um) <= limit + explained < abs(loops[other].closure_um):
                break  # the cycle before began from rest, so that this one is the first of its kind
            difference = sign * (_profile(paths[other]) - _profile(path))
            alike = float(np.sqrt(np.mean(difference**2))) <= limit + explained
            # the first cycle from rest differs where it begins only, which shows in what does not close
            settled = alike and abs(loop.closure_um) <= limit + explained
            return replace(loop, drift_um=float(difference.mean()), settled=settled)
    closed = abs(float(path.u[0] - path.u[-1])) <= max(same_v, 0.01 * loop.amplitude_v)
    clear = limit <= LONE_SHARE * loop.height_um
    return replace(loop, settled=closed and clear and abs(loop.closure_um) <= limit)


def _profile(path: _Path) -> Array:
    """Output on a fixed grid of voltage, first branch then second; tips left out, where slopes are steep."""
    low, high = float(path.u.min()), float(path.u.max())
    grid = np.linspace(low, high, GRID + 2)[1:-1]
    first = np.interp(grid, *_increasing(path.u[: path.turn + 1], path.y[: path.turn + 1]))
    second = np.interp(grid, *_increasing(path.u[path.turn :], path.y[path.turn :]))
    return np.concatenate([first, second])
