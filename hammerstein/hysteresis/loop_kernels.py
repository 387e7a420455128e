"""Hysteresis of any kind as part of a compiled loop with feedback."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import extending

from hammerstein.compiled import LEAN, Loop, at, helper
from hammerstein.hysteresis.bouc_wen_kernels import respond_bouc_wen
from hammerstein.hysteresis.play_kernels import respond_turning_points
from hammerstein.hysteresis.preisach_kernels import respond_preisach
from hammerstein.hysteresis.rate_dependent_kernels import respond_rate_dependent
from hammerstein.hysteresis.shape_kernels import add_dead_zones, tanh_by_doubling

ADDS: dict[type, Loop] = {}
"""Functions that advance hysteresis by one sample, by the class of its parameters."""


def adds(numbers: type, **options: str) -> Callable[[Loop], Loop]:
    """Register a function for a class of parameters, a named tuple of arrays; see ``add_outputs``.

    options : of ``helper``
    """

    def decorate(add: Loop) -> Loop:
        ADDS[numbers] = helper(**options)(add)
        return add

    return decorate


def add_outputs(numbers, i, z, now, w):  # type: ignore[no-untyped-def]
    """Add what z (h, 1) makes to what is now from w on; the memory, which is among the numbers, moves on.

    It is called for each input i in their order, as soon as z is known up to it: plays of one input that move
    while the next one is computed take a tenth less of the time of a loop. All other kinds wait for the last.
    """
    ADDS[type(numbers)](numbers, i, z, now, w)


@extending.overload(add_outputs, jit_options=LEAN, inline="always")  # type: ignore[arg-type]  # of numba
def _add_outputs(numbers, i, z, now, w):  # type: ignore[no-untyped-def]
    add = ADDS[numbers.instance_class]
    return lambda numbers, i, z, now, w: add(numbers, i, z, now, w)


@helper()
def _complete(i, z, now, w):  # type: ignore[no-untyped-def]
    """Whether i is the last input, and all are finite; outputs of others are no numbers."""
    if i + 1 < z.shape[0]:
        return False
    for k in range(z.shape[0]):
        if not np.isfinite(z[k, 0]):
            now[w] = np.nan
            return False
    return True


@helper()
def _add(v, now, w):  # type: ignore[no-untyped-def]
    for o in range(v.shape[0]):
        now[w + o] += v[o, 0]


class Plays(NamedTuple):
    """Plays in their simple form, for few of them and frequent turns.

    r : (h, J) thresholds, filled up with infinity; weight : (h, J, q)
    touched : (h, 2) first and last + 1 of the outputs that a z moves; p : (h, J) plays
    """

    r: Any
    weight: Any
    touched: Any
    p: Any


@adds(Plays, inline="always")
def _(own, i, z, now, w):  # type: ignore[no-untyped-def]
    r, weight, touched, p = own
    here = z[at(i), 0]
    for j in range(r.shape[1]):
        p[at(i), at(j)] = max(here - r[at(i), at(j)], min(here + r[at(i), at(j)], p[at(i), at(j)]))
    for o in range(touched[at(i), 0], touched[at(i), 1]):
        total = now[at(w + o)]
        for j in range(r.shape[1]):
            total += weight[at(i), at(j), at(o)] * p[at(i), at(j)]
        now[at(w + o)] = total


class Branches(NamedTuple):
    """Plays in their turning-point form: bank and stack, see ``respond_turning_points``.

    outputs : q zeros in a tuple; v : (q, 1), overwritten
    """

    numbers: Any
    outputs: Any
    v: Any


@adds(Branches)
def _(own, i, z, now, w):  # type: ignore[no-untyped-def]
    if _complete(i, z, now, w):
        respond_turning_points(z, *own.numbers, 0, 1, own.v, own.outputs)
        _add(own.v, now, w)


class Zones(NamedTuple):
    """Plays as ``Branches``, and dead-zones beside them: see ``add_dead_zones``."""

    plays: Any
    numbers: Any


@adds(Zones)
def _(own, i, z, now, w):  # type: ignore[no-untyped-def]
    if _complete(i, z, now, w):
        plays = own.plays
        respond_turning_points(z, *plays.numbers, 0, 1, plays.v, plays.outputs)
        add_dead_zones(z, *own.numbers, plays.v, plays.outputs)
        _add(plays.v, now, w)


class Envelopes(NamedTuple):
    """Plays as ``Branches`` behind envelopes.

    lines : of each z, working point and value there (h,); end, value at 0 and slope of each line (h, line)
    tangents : size, steepness and centre (h,); seen : (h, 1) what the plays see, overwritten
    """

    plays: Any
    lines: Any
    tangents: Any
    seen: Any


@adds(Envelopes)
def _(own, i, z, now, w):  # type: ignore[no-untyped-def]
    if _complete(i, z, now, w):
        (rest, home, end, start, slope), (size, steepness, centre) = own.lines, own.tangents
        for k in range(z.shape[0]):
            whole = z[k, 0] + rest[k]
            line = np.searchsorted(end[k], whole)
            value = start[k, line] + slope[k, line] * whole
            if size[k] > 0.0:
                value += size[k] * tanh_by_doubling(steepness[k] * (whole - centre[k]))
            own.seen[k, 0] = value - home[k]
        respond_turning_points(own.seen, *own.plays.numbers, 0, 1, own.plays.v, own.plays.outputs)
        _add(own.plays.v, now, w)


class Whole(NamedTuple):
    """Numbers of a kind as its own kernel takes them; v : (q, 1), overwritten."""

    numbers: Any
    v: Any


class Staircases(Whole):
    """Preisach planes, see ``respond_preisach``."""


class Rates(Whole):
    """Plays that grow with the rate, see ``respond_rate_dependent``."""


class Lags(Whole):
    """Bouc-Wen hysteresis, see ``respond_bouc_wen``."""


def _by(respond: Loop) -> Loop:
    def add(own, i, z, now, w):  # type: ignore[no-untyped-def]
        if _complete(i, z, now, w):
            respond(z, *own.numbers, 0, 1, own.v)
            _add(own.v, now, w)

    return add


adds(Staircases)(_by(respond_preisach))
adds(Rates)(_by(respond_rate_dependent))
adds(Lags)(_by(respond_bouc_wen))


class Sum(NamedTuple):
    """Parameters of the previous parts, and of the last part."""

    before: Any
    last: Any


@adds(Sum)
def _(both, i, z, now, w):  # type: ignore[no-untyped-def]
    add_outputs(both.before, i, z, now, w)  # type: ignore[no-untyped-call]
    add_outputs(both.last, i, z, now, w)  # type: ignore[no-untyped-call]
