"""Compiled loops of the inverse of the linear block. Every sum has a fixed order for any signal length."""

import numpy as np

from hammerstein.compensators.exact.inverse_kernel import respond_exact
from hammerstein.compensators.exact.piece_kernels import loaded, unloaded
from hammerstein.compensators.kernels import to_sent
from hammerstein.compiled import at, compiled


@compiled()
def filtered(taps, y, first, stop, out):  # type: ignore[no-untyped-def]
    """out[i, k] = sum over j of taps[j] y[i, k+j]: y (p, N + taps - 1), out (p, N) from first up to stop."""
    out[:, first:stop] = 0.0
    for i in range(out.shape[0]):
        for j in range(taps.shape[0]):
            for k in range(first, stop):
                out[i, at(k)] += taps[j] * y[i, at(k + j)]


@compiled()
def run_inverse(a, b, c, taps, ahead, x, y, first, stop, v):  # type: ignore[no-untyped-def]
    """x[k+1] = a x[k] + b y+[k], v[k] = c x[k] + sum of taps[j] y+[k+j], with y+_i[k] = y[i, k + ahead_i].

    a (n, n), b (n, p), c (p, n); taps (j, p, p); ahead (p,); x (n,) updated
    y (p, N + longest ahead + taps - 1); v (p, N) overwritten from sample first up to stop
    """
    n, p = b.shape
    v[:, first:stop] = 0.0
    for o in range(p):
        for i in range(p):
            for j in range(taps.shape[0]):
                for k in range(first, stop):
                    v[o, at(k)] += taps[j, o, i] * y[i, at(k + j + ahead[i])]
    new = x.copy()
    for k in range(first, stop):
        for o in range(p):
            for s in range(n):
                v[o, at(k)] += c[o, s] * x[s]
        for s in range(n):
            total = 0.0
            for q in range(n):
                total += a[s, q] * x[q]
            for i in range(p):
                total += b[s, i] * y[i, at(k + ahead[i])]
            new[s] = total
        for s in range(n):
            x[s] = new[s]


@compiled(error_model="numpy")
def step_path(  # type: ignore[no-untyped-def]
    sample, frame, filter_taps, inverse, recovery, table, about, raw, known, modes, away, stack, hand
):
    """Absolute voltages (m,), memory after one sample (p,), and whether all are finite.

    frame : as for ``to_sent``; filter_taps : of the reference filter, one: none
    inverse : a, b, c, taps, ahead of ``run_inverse``; recovery : a, b, gain of ``respond_exact``
    table, about : of the exact inverse; the others are the memory; nothing of these is written to
    """
    m, p = table.shape[0], sample.shape[0]
    references, path = np.empty((p, raw.shape[1] + 1)), np.empty((p, known.shape[1] + 1))
    v, drive, sent = np.empty((p, 1)), np.empty((m, 1)), np.empty(m)
    references[:, : raw.shape[1]], path[:, : known.shape[1]] = raw, known
    sound = True
    for o in range(p):
        sound = sound and np.isfinite(sample[o])
        references[o, raw.shape[1]] = path[o, known.shape[1]] = sample[o]
    if filter_taps.shape[0] > 1:
        newest = np.empty((p, 1))
        filtered(filter_taps, references, 0, 1, newest)
        path[:, known.shape[1]] = newest[:, 0]
    moving, left = modes.copy(), away.copy()
    w, here = loaded(table, about, stack, hand)
    if sound:
        a, b, c, taps, ahead = inverse
        run_inverse(a, b, c, taps, ahead, moving, path, 0, 1, v)
        for o in range(p):
            v[o, 0] += frame[0, o]
        back, into, gain = recovery
        respond_exact(v, m - p, back, into, gain, left, w, here, 0, 1, drive)
        sound = to_sent(drive, frame, sent)
    after, held = np.empty(stack.shape), np.empty(hand.shape)
    unloaded(w, here, after, held)
    return sent, references[:, 1:].copy(), path[:, 1:].copy(), moving, left, after, held, sound
