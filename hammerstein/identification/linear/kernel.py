"""Compiled sum over the lines of the normal equations of a state-space model."""

import numpy as np

from hammerstein.compiled import compiled


@compiled(fastmath=True)
def add_normal_equations(Z, X, error, left, row, column, hessian, gradient):  # type: ignore[no-untyped-def]
    """Add J^T J (its upper triangle) and J^T e of every line.

    A parameter that all outputs share has the derivative Z[a, row] X[column, c] in output a and column c, one
    of output a alone the derivative X[j, c]. The Jacobian itself is never built: products of Z with itself
    and of X with itself are formed once a line, and an entry of J^T J is a product of two of them.

    Z : (line, p, n) outputs for a unit state; X : (line, n + m, m) states and inputs
    error : (line, p, m); left : (line, p) weights
    row, column : (shared,) indices into n and n + m of the shared parameters, the others follow by output
    hessian : (shared + p (n + m), the same), gradient : (shared + p (n + m),), both updated
    """
    lines, p, n = Z.shape
    own, m = X.shape[1:]
    shared = row.shape[0]
    zz, xx = np.empty((n, n), np.complex128), np.empty((own, own), np.complex128)
    zr, zi = np.empty((n, shared)), np.empty((n, shared))
    xr, xi = np.empty((own, shared)), np.empty((own, shared))
    for k in range(lines):
        for i in range(n):
            for j in range(i, n):
                total = 0j
                for a in range(p):
                    total += left[k, a] ** 2 * np.conj(Z[k, a, i]) * Z[k, a, j]
                zz[i, j], zz[j, i] = total, np.conj(total)
        for i in range(own):
            for j in range(i, own):
                total = 0j
                for c in range(m):
                    total += np.conj(X[k, i, c]) * X[k, j, c]
                xx[i, j], xx[j, i] = total, np.conj(total)
        for t in range(shared):  # side by side, so that the longest loop below runs straight through
            for i in range(n):
                zr[i, t], zi[i, t] = zz[i, row[t]].real, zz[i, row[t]].imag
            for i in range(own):
                xr[i, t], xi[i, t] = xx[i, column[t]].real, xx[i, column[t]].imag
        for s in range(shared):
            i, j = row[s], column[s]
            for t in range(s, shared):
                hessian[s, t] += zr[i, t] * xr[j, t] - zi[i, t] * xi[j, t]
            for a in range(p):
                z = left[k, a] ** 2 * Z[k, a, i]
                start = shared + a * own
                for t in range(own):
                    hessian[s, start + t] += z.real * xx[j, t].real + z.imag * xx[j, t].imag
                for c in range(m):
                    gradient[s] += (np.conj(z * X[k, j, c]) * error[k, a, c]).real
        for a in range(p):
            weight, start = left[k, a] ** 2, shared + a * own
            for s in range(own):
                for t in range(s, own):
                    hessian[start + s, start + t] += weight * xx[s, t].real
                for c in range(m):
                    gradient[start + s] += weight * (np.conj(X[k, s, c]) * error[k, a, c]).real
