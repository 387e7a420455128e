"""Compiled time loops of the Bouc-Wen model."""

import math

from hammerstein.compiled import compiled, helper

LONGEST = 0.015625
"""Largest step in parts of the voltage in which z relaxes; a longer movement is made of several."""
FORGOTTEN = 64.0
"""Movement in these parts after which z stands at its limit to the last bit."""
MOST_SUBSTEPS = 8192
"""Steps of one movement at most: FORGOTTEN / LONGEST while z grows; while it falls fewer, unless it stands
still at a limit, where more of them change nothing."""
FEW = 4
"""Steps that take as long as an exponential."""


@helper()
def moved(z, du, load, unload):  # type: ignore[no-untyped-def]
    """Return z after a movement du: dz = du - c |du| z, c = load while z grows and unload while it falls.

    Each step is the midpoint rule, which is rational: z <- (z (1 - c d / 2) + s d) / (1 + c d / 2). One in
    which z changes its sign ends at zero.
    """
    sign = 1.0 if du > 0.0 else -1.0
    left = abs(du)
    for _ in range(MOST_SUBSTEPS):
        if left <= 0.0:
            break
        falls = sign * z < 0.0
        if not falls and load * left > FORGOTTEN:
            return sign / load
        c = unload if falls else load
        d = min(left, LONGEST / abs(c)) if c != 0.0 else left
        if falls:
            zero = -sign * z / (1.0 - 0.5 * sign * c * z)
            if zero <= d:
                z = 0.0
                left -= zero
                continue
        half = 0.5 * c * d
        z = (z * (1.0 - half) + sign * d) / (1.0 + half)
        left -= d
    return z


@compiled()
def respond_bouc_wen(u, direct, hysteretic, load, unload, z, last, first, stop, y):  # type: ignore[no-untyped-def]
    """y_l = sum over k of d_lk u_k - a_lk z_lk.

    u : (m, N); direct, hysteretic, load, unload : (p, m); z : (p, m), last : (m,), updated in place
    y : (p, N), overwritten from sample first up to stop
    """
    for t in range(first, stop):
        for o in range(y.shape[0]):
            y[o, t] = 0.0
        for k in range(u.shape[0]):
            du = u[k, t] - last[k]
            last[k] = u[k, t]
            for o in range(y.shape[0]):
                if du != 0.0 and hysteretic[o, k] != 0.0:
                    z[o, k] = moved(z[o, k], du, load[o, k], unload[o, k])
                y[o, t] += direct[o, k] * u[k, t] - hysteretic[o, k] * z[o, k]


@compiled()
def lagging(u, load, unload, z, last, out):  # type: ignore[no-untyped-def]
    """Return out (N,) the z of one pair for the voltages u (N,), from z where the voltage was ``last``.

    Movements of many steps go in closed form: a search comes to shapes that bend within a part of a sample.
    """
    far = FEW * LONGEST / max(abs(load), abs(unload))
    for t in range(len(u)):
        du = u[t] - last
        last = u[t]
        if abs(du) > far:
            z = moved_far(z, du, load, unload)
        elif du != 0.0:
            z = moved(z, du, load, unload)
        out[t] = z
    return z


@helper()
def moved_far(z, du, load, unload):  # type: ignore[no-untyped-def]
    """Return z after a movement du as ``moved``, by the exponentials that its steps approach."""
    sign = 1.0 if du > 0.0 else -1.0
    own, left = sign * z, abs(du)
    if own < 0.0:
        inside = 1.0 - unload * own
        if inside <= 0.0:
            return z  # it stands at a limit that it does not leave
        zero = math.log(inside) / unload if unload != 0.0 else -own
        if zero >= left:
            return sign * min(_grown(own, left, unload), 0.0)
        own, left = 0.0, left - zero
    return sign * _grown(own, left, load)


@helper()
def _grown(z, d, c):  # type: ignore[no-untyped-def]
    """Solve dz = (1 - c z) dd."""
    return z + d if c == 0.0 else z + (z - 1.0 / c) * math.expm1(-c * d)
