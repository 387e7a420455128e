"""Compiled sums over the errors of a path: what its figures of merit need, in one pass over memory."""

import numpy as np

from hammerstein.compiled import at, compiled, helper

BLOCK = 512  # samples of all axes that stay in the cache; their sums are added up block by block


@compiled()
def error_sums(path, target, squares, largest):  # type: ignore[no-untyped-def]
    """Sums of squares and largest squares of an error, axis by axis, and of the distance of all axes.

    path, target : p rows (N,); squares, largest : (p+1,) zeros, the distance last; filled
    """
    p, samples = len(path), path[0].shape[0]
    square, distance, tops = np.empty(BLOCK), np.empty(BLOCK), largest.view(np.int64)
    for start in range(0, samples, BLOCK):
        count = min(BLOCK, samples - start)
        for i in range(count):
            distance[at(i)] = 0.0
        for o in range(p):
            for i in range(count):
                error = path[o][at(start + i)] - target[o][at(start + i)]
                square[at(i)] = error * error
                distance[at(i)] += error * error
            squares[o] += _sum(square, count)
            tops[o] = max(tops[o], _top(square, count))
        squares[p] += _sum(distance, count)
        tops[p] = max(tops[p], _top(distance, count))


@helper(fastmath={"reassoc"})
def _sum(values, samples):  # type: ignore[no-untyped-def]
    """Sum of the first samples, in any order."""
    total = 0.0
    for t in range(samples):
        total += values[at(t)]
    return total


@helper()
def _top(values, samples):  # type: ignore[no-untyped-def]
    """Bits of the largest of the first samples, which are not negative.

    Such numbers have the order of their bits. Integers compare eight times as fast, and NaN is above all.
    """
    bits, found = values.view(np.int64), np.int64(0)
    for t in range(samples):
        found = max(found, bits[at(t)])
    return found


@compiled()
def plane_errors(u, v, x, y, p, q, middle):  # type: ignore[no-untyped-def]
    """Largest errors of the radius of two paths in the plane.

    u, v : reference (N,); x, y : reading (N,); p, q : position (N,), all counted from a middle (2,)
    """
    first, second, largest = np.empty(BLOCK), np.empty(BLOCK), np.zeros(2)
    tops = largest.view(np.int64)
    for start in range(0, u.shape[0], BLOCK):
        count = min(BLOCK, u.shape[0] - start)
        for i in range(count):
            t = at(start + i)
            a, b = u[t] - middle[0], v[t] - middle[1]
            c, d = x[t] - middle[0], y[t] - middle[1]
            e, f = p[t] - middle[0], q[t] - middle[1]
            wanted = np.sqrt(a * a + b * b)
            first[at(i)] = abs(np.sqrt(c * c + d * d) - wanted)
            second[at(i)] = abs(np.sqrt(e * e + f * f) - wanted)
        tops[0] = max(tops[0], _top(first, count))
        tops[1] = max(tops[1], _top(second, count))
    return largest[0], largest[1]
