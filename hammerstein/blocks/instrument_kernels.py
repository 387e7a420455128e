"""Compiled time loops of drive and sensor: one pass over memory instead of a dozen."""

import numpy as np

from hammerstein.compiled import at, compiled


@compiled(inline="always")
def converted(value, low, high, step):  # type: ignore[no-untyped-def]
    """Clip to a range and round to a step, as a converter does; NaN stays NaN."""
    held = value
    if held < low:
        held = low
    if held > high:
        held = high
    return held if step == 0.0 else np.rint(held / step) * step


@compiled()
def convert(asked, steps, ends, step, drive, cut):  # type: ignore[no-untyped-def]
    """Output voltages of the converter, and samples that the range clipped.

    asked : (m, N) [V]; steps : (2, m) lowest and highest step; ends : (2, m) limits of the range [V]
    step : of the converter [V]; drive : (m, N), overwritten; cut : (m, N), overwritten
    """
    for k in range(asked.shape[0]):
        low, high = steps[0, k], steps[1, k]
        least, most = ends[0, k], ends[1, k]
        for t in range(asked.shape[1]):
            value = asked[k, at(t)]
            drive[k, at(t)] = converted(value, low, high, step)
            cut[k, at(t)] = (value < least) | (value > most)


@compiled()
def leaving(asked, rest, ends, left):  # type: ignore[no-untyped-def]
    """Whether a voltage reaches an end of its range; ``left`` records which inputs have moved from ``rest``.

    asked : (m, N) [V]; rest : (m,) [V]; ends : (2, m) of the ranges; left : (m,)
    """
    reached = 0
    for k in range(asked.shape[0]):
        at_rest, low, high, moved = rest[k], ends[0, k], ends[1, k], 0
        for t in range(asked.shape[1]):
            value = asked[k, at(t)]
            moved += value != at_rest
            reached += (value <= low) | (value >= high)
        left[k] |= moved > 0
    return reached > 0


@compiled()
def outside(wire, first, stop, low, high):  # type: ignore[no-untyped-def]
    """Number of values of a wire (axis, N) outside two bounds, from sample first up to stop."""
    found = 0
    for k in range(wire.shape[0]):
        for t in range(first, stop):
            found += not (low <= wire[k, at(t)] <= high)
    return found


@compiled()
def digitise(drawn, noise, largest, step, first, reading):  # type: ignore[no-untyped-def]
    """Turn positions into readings: noise, range and step.

    drawn : (p, n) standard normal numbers; noise : rms [um]; largest : reading of either sign [um]
    step : of the reading [um]; reading : (p, N) positions [um], n of them overwritten from sample first on
    """
    for o in range(reading.shape[0]):
        given, row = drawn[o], reading[o, first : first + drawn.shape[1]]
        for i in range(len(row)):
            row[at(i)] = converted(row[at(i)] + noise * given[at(i)], -largest, largest, step)
