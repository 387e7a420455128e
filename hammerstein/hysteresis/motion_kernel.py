"""Compiled time loop of the derivatives of plays by their thresholds."""

from __future__ import annotations

from hammerstein.compiled import compiled


@compiled()
def threshold_derivatives(p, before, sign, d):  # type: ignore[no-untyped-def]
    """dp/dr of every play: -1 after it was last moved upwards, 1 after downwards, 0 before it was moved.

    p : (n, N) outputs of the plays; before : (n,) outputs before the first sample
    sign : (n,) derivatives before the first sample, updated in place; d : (n, N) derivatives, overwritten
    """
    for i in range(p.shape[0]):
        last, now = before[i], sign[i]
        for t in range(p.shape[1]):
            if p[i, t] > last:
                now = -1.0
            elif p[i, t] < last:
                now = 1.0
            last = p[i, t]
            d[i, t] = now
        sign[i] = now
