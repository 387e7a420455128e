"""Compiled loops of plays inside the loop: trajectory of a record, and its exact derivatives.

One row of a *path* holds all factors that a sample multiplies with model parameters: state x, input u,
hysteresis w, every play minus its linear part, g = p - beta z, every product of hysteresis inputs, and the
inputs themselves relative to their limits, followed by a 1. The derivative with respect to one parameter
therefore starts from one entry of that row and follows the same linear equations.
"""

import numpy as np

from hammerstein.compiled import compiled

WIDTH = 128
"""Parameters whose derivatives are computed together, so that they fit the cache."""


@compiled(fastmath=True, nogil=True, error_model="numpy")
def follow(A, B, E, inner, c, K, beta, r, factors, limit, u, warm, path, hits):  # type: ignore[no-untyped-def]
    """Path (warm + N, n + m + v (2 h + h J + M + 1)), hits (warm + N, v h, J) of a periodic input u (m, N).

    x+ = A x + B u + E w, z = F x + G u + H w, w_i = sum over j of c_ij (p_ij - beta_ij z_i) + K_ij product_j
    A : (n / 2, 2, 2) blocks; hits : 1 or -1 where a play is pushed up or down, 0 where it stands
    inner : (v h, n + m + h) [F, G, H], the rows of each of v moves in a sample; the first takes no w
    factors : (M, 3) which parts of limits are multiplied; h is the 1
    """
    n, m, h, J = B.shape[0], B.shape[1], r.shape[0], r.shape[1]
    samples, products, moves = u.shape[1], K.shape[1], inner.shape[0] // max(r.shape[0], 1)
    x, later, p = np.zeros(n), np.zeros(n), np.zeros((h, J))
    iu, stride = n, 2 * h + h * J + products + 1
    for t in range(samples + warm):
        k = (t - warm) % samples
        row = path[t]
        for a in range(n):
            row[a] = x[a]
        for i in range(m):
            row[iu + i] = u[i, k]
        for v in range(moves):
            iw = n + m + v * stride
            ig, im, iz = iw + h, iw + h + h * J, iw + h + h * J + products
            for i in range(h):
                z, w = 0.0, 0.0
                for a in range(n + m if v == 0 else n + m + h):
                    z += inner[v * h + i, a] * row[a]
                for j in range(J):
                    q, hit = p[i, j], 0
                    if z - r[i, j] > q:
                        q, hit = z - r[i, j], 1
                    elif z + r[i, j] < q:
                        q, hit = z + r[i, j], -1
                    p[i, j], hits[t, v * h + i, j] = q, hit
                    g = q - beta[i, j] * z
                    row[ig + i * J + j] = g
                    w += c[i, j] * g
                row[iw + i] = w
                row[iz + i] = min(max(z / limit[i], -1.0), 1.0)
            row[iz + h] = 1.0
            for j in range(products):
                product = row[iz + factors[j, 0]] * row[iz + factors[j, 1]] * row[iz + factors[j, 2]]
                row[im + j] = product
                for i in range(h):
                    row[iw + i] += K[i, j] * product
        for a in range(n):
            b = a // 2
            s = A[b, a % 2, 0] * x[2 * b] + A[b, a % 2, 1] * x[2 * b + 1]
            for i in range(m):
                s += B[a, i] * u[i, k]
            for v in range(moves):
                for i in range(h):
                    s += E[a, v * h + i] * row[n + m + v * stride + i]
            later[a] = s
        x, later = later, x


@compiled(fastmath=True, nogil=True, error_model="numpy")
def differentiate(A, C, E, F, H, c, K, beta, r, limit, factors, path, hits, source, target, first, warm, out):  # type: ignore[no-untyped-def]
    """Derivatives out (p, N, P) of the outputs by the numbers first, first + 1, ... first + WIDTH.

    All arrays of numbers are float32.
    source : (P,) entry of the path that a number is multiplied with, that of the first move where each move
        has its own; -1 - i J - j for the logarithm of r_ij
    target : (P,) row of (x, z, w, y) that the product is added to; all moves have one w there
    """
    n, h, J, p = E.shape[0], r.shape[0], r.shape[1], C.shape[0]
    rows = F.shape[0]
    stride = 2 * h + h * J + K.shape[1] + 1
    count = min(WIDTH, source.shape[0] - first)
    S, later = np.zeros((n, WIDTH), np.float32), np.zeros((n, WIDTH), np.float32)
    dz, dw = np.zeros((rows, WIDTH), np.float32), np.zeros((rows, WIDTH), np.float32)
    dp, dy = np.zeros((h, J, WIDTH), np.float32), np.zeros((p, WIDTH), np.float32)
    slope = np.zeros((h, h), np.float32)
    for t in range(path.shape[0]):
        row = path[t]
        np.dot(F, S, dz)
        for q in range(count):
            to = target[first + q] - n
            if 0 <= to < rows and source[first + q] >= 0:
                dz[to, q] += row[source[first + q]]
        for v in range(0, rows, h):
            more = v // h * stride
            last = row.shape[0] - (rows - v) // h * stride + stride
            _steepness(K, limit, factors, row[last - h - 1 : last], slope)
            if v > 0:
                for i in range(h):
                    for k in range(h):
                        weight = H[i, k]
                        for q in range(WIDTH):
                            dz[v + i, q] += weight * dw[k, q]
            for i in range(h):
                straight = np.float32(0.0)
                for j in range(J):
                    straight -= c[i, j] * beta[i, j]
                for q in range(WIDTH):
                    dw[v + i, q] = straight * dz[v + i, q]
                for j in range(J):
                    if hits[t, v + i, j] != 0:
                        for q in range(WIDTH):
                            dp[i, j, q] = dz[v + i, q]
                        own = -1 - i * J - j
                        for q in range(count):
                            if source[first + q] == own:
                                dp[i, j, q] -= hits[t, v + i, j] * r[i, j]
                    weight = c[i, j]
                    for q in range(WIDTH):
                        dw[v + i, q] += weight * dp[i, j, q]
                for k in range(h):
                    if slope[i, k] != 0.0:
                        weight = slope[i, k]
                        for q in range(WIDTH):
                            dw[v + i, q] += weight * dz[v + k, q]
            for q in range(count):
                to = target[first + q] - n - rows
                if 0 <= to < h and source[first + q] >= 0:
                    dw[v + to, q] += row[source[first + q] + more]
        if t >= warm:
            np.dot(C, S, dy)
            for q in range(count):
                to = target[first + q] - n - rows - h
                if to >= 0 and source[first + q] >= 0:
                    dy[to, q] += row[source[first + q]]
            for o in range(p):
                for q in range(count):
                    out[o, t - warm, first + q] = dy[o, q]
        np.dot(E, dw, later)
        for a in range(n):
            b = a // 2
            _two(A[b, a % 2], S[2 * b : 2 * b + 2], later[a])
        for q in range(count):
            to = target[first + q]
            if to < n and source[first + q] >= 0:
                later[to, q] += row[source[first + q]]
        S, later = later, S


@compiled(fastmath=True, nogil=True, error_model="numpy")
def _steepness(K, limit, factors, part, slope):  # type: ignore[no-untyped-def]
    """Put the derivatives (h, h) of the weighted products by z into slope; 0 beyond a limit."""
    h = limit.shape[0]
    slope[:] = np.float32(0.0)
    for j in range(factors.shape[0]):
        for f in range(3):
            k = factors[j, f]
            if k < h and abs(part[k]) < 1.0:
                others = part[factors[j, (f + 1) % 3]] * part[factors[j, (f + 2) % 3]] / limit[k]
                for i in range(h):
                    slope[i, k] += K[i, j] * others


@compiled(fastmath=True, nogil=True, error_model="numpy")
def _two(g, S, total):  # type: ignore[no-untyped-def]
    """Add g (2,) S (2, WIDTH) to a total (WIDTH,)."""
    a, b = g[0], g[1]
    for q in range(WIDTH):
        total[q] += a * S[0, q] + b * S[1, q]
