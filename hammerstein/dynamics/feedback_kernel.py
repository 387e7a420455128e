"""Compiled time loop of hysteresis in the loop of a linear block."""

import numpy as np

from hammerstein.compiled import at, compiled, helper
from hammerstein.hysteresis.loop_kernels import add_outputs


@compiled()
def respond_loop(start, column, value, push, gamma, limit, factors, K, x, u, first, end, y):  # type: ignore[no-untyped-def]
    """z, x[k+1], y[k] = [[F, G, H], [A, B, E], [C, D, 0]] (x[k], u[k], w[k]), w = Gamma(z).

    Its parts are compiled into it: a call of each would take a third longer.

    B and E are filled, and added column by column: many sums at once, of which none waits for another.

    Weighted products of z, as parts of their limits and within them, are added to w.

    The rows of z come first: w follows from them within the sample. There are h for every move of Gamma,
    and those of a move hold w of the moves before alone. A z beyond all numbers makes w none.

    start : (v h+n+o+1,) first entry of each row; column, value : (entry,)
    push : (m + v q, n) [B, E] turned, whose entries are not among these
    gamma : numbers of the hysteresis, see ``loop_kernels``; its memory is updated in place
    limit : (h,); factors : (M, 3) which z a product is of, h where there is none; K : (q, M) weights
    x : (n,) state, updated in place; u : (m, N); y : (o, N), from first up to end
    """
    n, m, h, q = x.shape[0], u.shape[0], limit.shape[0], K.shape[0]
    outputs, products = y.shape[0], factors.shape[0]
    rows = start.shape[0] - 1 - n - outputs
    part, product, z = np.ones(h + 1), np.empty(products), np.empty((h, 1))
    now, later = np.zeros(n + m + rows // h * q), np.zeros(n + m + rows // h * q)
    for i in range(n):
        now[i] = x[i]
    for t in range(first, end):
        for j in range(m):
            now[at(n + j)] = u[at(j), at(t)]
        for j in range(rows // h * q):
            now[at(n + m + j)] = 0.0
        here, onto = 0, n + m
        for i in range(rows + n + outputs):
            total = _row(value, column, now, at(start[at(i)]), at(start[at(i + 1)]))
            if i < rows:
                z[at(here), 0] = total
                part[at(here)] = max(min(total / limit[at(here)], 1.0), -1.0)
                add_outputs(gamma, here, z, now, onto)  # type: ignore[no-untyped-call]
                here += 1
                if here == h:
                    _multiply(factors, K, part, product, now, onto)
                    here, onto = 0, onto + q
            elif i < rows + n:
                later[at(i - rows)] = total
            else:
                y[at(i - rows - n), at(t)] = total
        for j in range(push.shape[0]):
            pushed = now[at(n + j)]
            for i in range(n):
                later[at(i)] += push[at(j), at(i)] * pushed
        now, later = later, now
    for i in range(n):
        x[i] = now[i]


@helper(inline="always")
def _row(value, column, now, e, stop):  # type: ignore[no-untyped-def]
    """Entries of a row times what is now; four sums at once: none waits for the one before."""
    a, b, c, total = 0.0, 0.0, 0.0, 0.0
    while e + at(3) < stop:
        a += value[e] * now[at(column[e])]
        b += value[e + at(1)] * now[at(column[e + at(1)])]
        c += value[e + at(2)] * now[at(column[e + at(2)])]
        total += value[e + at(3)] * now[at(column[e + at(3)])]
        e += at(4)
    total = (a + b) + (c + total)
    while e < stop:
        total += value[e] * now[at(column[e])]
        e += at(1)
    return total


@helper(inline="always")
def _multiply(factors, K, part, product, now, w):  # type: ignore[no-untyped-def]
    """Add the weighted products of parts of z to what is now from w on."""
    for j in range(factors.shape[0]):
        first_two = part[at(factors[at(j), 0])] * part[at(factors[at(j), 1])]
        product[at(j)] = first_two * part[at(factors[at(j), 2])]
    for o in range(K.shape[0]):
        moved = now[at(w + o)]
        for j in range(factors.shape[0]):
            moved += K[at(o), at(j)] * product[at(j)]
        now[at(w + o)] = moved
