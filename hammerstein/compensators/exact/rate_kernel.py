"""Compiled time loop of the exact inverse of rate-dependent plays.

The thresholds of a sample are known before it, so that its map is piecewise linear in each voltage and has no
memory within the sample: plays stand still between p - R and p + R and follow outside. It is given to the
walk of ``inverse_kernel`` as dead-zones beside a single play of threshold and weight 0.
"""

from __future__ import annotations

import numpy as np

from hammerstein.compensators.exact.inverse_kernel import drift, walk
from hammerstein.compiled import compiled, helper
from hammerstein.hysteresis.rate_dependent_kernels import next_rate, threshold


@compiled(error_model="numpy")
def respond_exact_rate(  # type: ignore[no-untyped-def]
    reference,
    a,
    b,
    gain,
    x,
    w,
    here,
    sample_time,
    pole,
    n,
    r,
    grow,
    lam,
    weights,
    plays,
    last,
    rate,
    first,
    stop,
    drive,
):
    """Drive (m, N) whose model output is the reference (p, N), from sample first up to stop.

    The drive is overwritten there, plays and rates are updated.

    a, b, gain, x : linear block behind it, as for ``respond_exact``; the others as for the forward loop
    """
    m, p = drive.shape[0], reference.shape[0]
    new, away = np.empty(x.shape[0]), False
    reach, (events, bend) = np.zeros(r.shape), np.empty((2, 2 * r.shape[1]))
    owner, order = np.empty(2 * r.shape[1], np.int64), np.arange(2 * r.shape[1])
    for s in range(x.shape[0]):
        away = away or x[s] != 0.0
    for t in range(first, stop):
        for k in range(m):
            next_rate(k, sample_time, pole, last, rate)
            for i in range(n[k]):
                reach[k, i] = threshold(k, i, r, grow, lam, rate)
            _zones_of(w, k, n[k], plays, reach, weights, events, owner, bend, order)
            here[k].wanted = w[k, 0].x
        for o in range(p):
            here[o].y = reference[o, t]
            if away:
                for s in range(x.shape[0]):
                    here[o].y -= gain[o, s] * x[s]
        walk(False, 0, w, here)
        for o in range(p):
            away = away or (here[o].missed != 0.0 and x.shape[0] > 0)
        for k in range(m):
            u = here[k].u
            drive[k, t] = u
            for i in range(n[k]):
                plays[k, i] = max(u - reach[k, i], min(u + reach[k, i], plays[k, i]))
            last[k, 1], last[k, 0] = last[k, 0], u
        if away:
            away = drift(reference, t, a, b, x, new, w, here)


@helper(error_model="numpy")
def _zones_of(w, k, n, plays, reach, weights, events, owner, bend, order):  # type: ignore[no-untyped-def]
    """Put the map of one sample of input k into its zones: at their ends a play is let go or taken up."""
    rows, count = weights.shape[2], 0
    for i in range(n):
        if reach[k, i] > 0.0:  # a play of threshold 0 never stands still
            events[count], events[count + 1] = plays[k, i] - reach[k, i], plays[k, i] + reach[k, i]
            owner[count], owner[count + 1] = i, i
            bend[count], bend[count + 1] = -1.0, 1.0
            count += 2
    _sort(events, count, order)
    for o in range(rows):
        slope, begin = 0.0, 0.0
        for i in range(n):
            slope += weights[k, i, o]
            begin += weights[k, i, o] * reach[k, i]
        w[k, 0].zone_slope[o], w[k, 0].zone_start[o] = slope, begin
    for z in range(count):
        event, i = events[order[z]], owner[order[z]]
        w[k, z].zone_end = event
        for o in range(rows):
            change = bend[order[z]] * weights[k, i, o]
            w[k, z + 1].zone_slope[o] = w[k, z].zone_slope[o] + change
            w[k, z + 1].zone_start[o] = w[k, z].zone_start[o] - change * event
    w[k, count].zone_end = np.inf


@helper()
def _sort(events, count, order):  # type: ignore[no-untyped-def]
    """Sort the first ``count`` entries of order by event; equal events by their numbers.

    The previous order only affects the time this takes: it hardly changes from sample to sample.
    """
    if count != order.shape[0]:
        for i in range(order.shape[0]):
            order[i] = i
    for i in range(1, count):
        now, j = order[i], i - 1
        event = events[now]
        while j >= 0 and (events[order[j]] > event or (events[order[j]] == event and order[j] > now)):
            order[j + 1] = order[j]
            j -= 1
        order[j + 1] = now
