"""What the theory of Prandtl-Ishlinskii models says, in plain NumPy; imports nothing of ours.

The printed table is equations 12 and 13 of the paper: V and um/V.
"""

import numpy as np

R_V = np.array([0.07, 0.32, 0.74, 1.3, 2.0, 2.8, 3.67, 4.61, 5.54, 6.5, 7.34, 8.1, 8.8, 9.3, 9.7])
W_XX = [4.3, -0.395, 0.117, 0.657, 0.207, 0.252, 0.605, 0.15, 0.265, 0.229, 0.207, 0.381, 0.411, 0.256, 2.28]
W_XY = [0.277, -0.0738, -0.162, 0.234, -0.312, 0.211, -0.0417, 0.0386, -0.0875, 0.145, -0.131, 0.0836]
W_XY += [-0.096, 0.073, 0.0268]
W_YX = [0.184, -0.0369, -0.0664, 0.0615, 0.0857, -0.0809, 0.0419, 0.0377, -0.0697, 0.062, 0.0328, 0.0639]
W_YX += [-0.175, 0.233, 0.165]
W_YY = [3.63, 0.0786, 0.00917, 0.255, 0.349, 0.424, 0.107, 0.18, 0.288, 0.204, 0.252, 0.144, 0.697]
W_YY += [-0.151, 0.97]
W_UM_PER_V = np.array([[W_XX, W_XY], [W_YX, W_YY]])  # (output, input, operator)


def play(u, r, start=0.0):
    """Equation 1, sample by sample: p[k] = max(u[k] - r, min(u[k] + r, p[k-1]))."""
    outputs, last, r = np.empty(len(u)), float(start), float(r)
    for k, voltage in enumerate(np.asarray(u, dtype=float).tolist()):  # far faster than of NumPy
        last = max(voltage - r, min(voltage + r, last))
        outputs[k] = last
    return outputs


def play_describing_function(amplitude, r):
    """First harmonic (in phase, and a quarter ahead) of a play over its sine, in parts of the amplitude.

    With s = 1 - 2 r / A: a1 = 1/2 + (asin s + s sqrt(1 - s^2)) / pi, b1 = -(1 - s^2) / pi (Gelb and Vander
    Velde, Multiple-input describing functions, 1968, backlash).
    """
    s = 1.0 - 2.0 * r / amplitude
    return 0.5 + (np.arcsin(s) + s * np.sqrt(1.0 - s * s)) / np.pi, -(1.0 - s * s) / np.pi


def plays(u, r, start):
    """Equation 1 for many thresholds r and starts (operator,) at once: outputs (operator, sample)."""
    outputs, last = np.empty((len(r), len(u))), start
    for k, voltage in enumerate(u):
        last = outputs[:, k] = np.maximum(voltage - r, np.minimum(voltage + r, last))
    return outputs


def prandtl_ishlinskii(u, thresholds, weights):
    """Equation 4: v_l = sum over j, i of w_lji play(u_j; r_lji); thresholds, weights: [l][j] -> list."""
    return np.array(
        [
            sum(
                (
                    w * play(u[j], r)
                    for j in range(len(u))
                    for r, w in zip(thresholds[o][j], weights[o][j], strict=True)
                ),
                np.zeros(len(u[0])),
            )
            for o in range(len(thresholds))
        ]
    )


def loop_amplitude(r, w, amplitude):
    """Half height of the settled loop: every play of threshold r < A swings between -(A - r) and A - r."""
    return sum(wi * (amplitude - ri) for ri, wi in zip(r, w, strict=True) if ri < amplitude)


def loop_area(r, w, amplitude):
    """Area of the settled loop: a play's loop is a parallelogram of width 2 r and height 2 (A - r)."""
    return sum(4 * wi * ri * (amplitude - ri) for ri, wi in zip(r, w, strict=True) if ri < amplitude)


def rising_branch(r, w, amplitude, u):
    """Rise above the lower tip: a play stands still until the voltage has risen by 2 r."""
    return sum(wi * np.maximum(0.0, u + amplitude - 2 * ri) for ri, wi in zip(r, w, strict=True))


def polygon_area(x, y):
    """Area within a closed polygon (shoelace formula), positive whichever way it runs."""
    return abs(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def dead_zone(u, q):
    """One-sided dead-zone: D_q(u) = max(u - q, 0)."""
    return np.maximum(np.asarray(u) - q, 0.0)


def asymmetric(u, thresholds, weights, breakpoints, bends, rest):
    """Plays beside one-sided dead-zones, from rest at ``rest`` [V], u as it is sent; lists are [l][j].

    v_l = sum over j of ( sum_i w play(u_j - rest_j; r_i) + sum_q b (D_q(rest_j + s) - D_q(rest_j)) ), where
    s = play(u_j - rest_j; r) with the smallest threshold r of input j over all outputs, 0 if it has none.
    """
    x = np.asarray(u) - np.asarray(rest)[:, None]
    outputs = prandtl_ishlinskii(x, thresholds, weights)
    for j in range(len(x)):
        smallest = min((r for row in thresholds for r in row[j]), default=0.0)
        s = play(x[j], smallest)
        for o in range(len(outputs)):
            for q, b in zip(breakpoints[o][j], bends[o][j], strict=True):
                outputs[o] += b * (dead_zone(rest[j] + s, q) - dead_zone(rest[j], q))
    return outputs


def asymmetric_branches(r, w, q, b, low, high, u):
    """Rising and falling branch at u of the settled loop between low and high (smallest r zero, engaged all).

    Up to one constant: plays rise from the lower tip, fall from the upper one, and each dead-zone adds the
    same to both.
    """
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    bottom = -loop_amplitude(r, w, half)
    line = sum(bi * dead_zone(u, qi) for qi, bi in zip(q, b, strict=True))
    rising = bottom + rising_branch(r, w, half, u - middle) + line
    falling = -bottom - rising_branch(r, w, half, middle - u) + line
    return rising, falling


def rate_dependent(u, sample_time, thresholds, growth, bandwidth, lam, weights):
    """Plays whose thresholds grow with the filtered rate until the sample before; lists [j], weights [l][j].

    R_i[k] = r_i + b_i g(rho[k]),  rho[k] = a rho[k-1] + (1 - a) (u[k-1] - u[k-2]) / T,  a = exp(-2 pi f T)
    """
    outputs = np.zeros((len(weights), len(u[0])))
    for j, signal in enumerate(u):
        a, rho, last, before = np.exp(-2 * np.pi * bandwidth[j] * sample_time), 0.0, 0.0, 0.0
        plays = np.zeros(len(thresholds[j]))
        for k, voltage in enumerate(signal):
            rho = a * rho + (1 - a) * (last - before) / sample_time
            g = np.log1p(lam[j] * abs(rho)) / lam[j] if lam[j] else abs(rho)
            reach = np.asarray(thresholds[j]) + np.asarray(growth[j]) * g
            plays = np.maximum(voltage - reach, np.minimum(voltage + reach, plays))
            before, last = last, voltage
            for o in range(len(weights)):
                outputs[o, k] += np.dot(weights[o][j], plays)
    return outputs


def bouc_wen_line(z, du, beta, gamma):
    """z after a straight line du of the voltage: dz = du - beta |du| z - gamma du |z|, by exponentials.

    z relaxes to s / c: c = beta + gamma while it grows in the direction s, beta - gamma while it falls.
    """
    s, left = np.sign(du), abs(du)
    if s * z < 0:
        c = beta - gamma
        way = np.log1p(c * abs(z)) / c if c else abs(z)  # until it is zero
        if way >= left:
            return s / c + (z - s / c) * np.exp(-c * left) if c else z + s * left
        z, left = 0.0, left - way
    c = beta + gamma
    return s / c + (z - s / c) * np.exp(-c * left) if c else z + s * left


def bouc_wen(u, direct, hysteretic, beta, gamma):
    """v_l = sum over j of ( d_lj u_j - a_lj z_lj ) from rest; u (m, N), all others (l, j)."""
    outputs = np.asarray(direct) @ np.asarray(u)
    for o in range(len(direct)):
        for j, signal in enumerate(u):
            z, last = 0.0, 0.0
            for k, voltage in enumerate(signal):
                z = bouc_wen_line(z, voltage - last, beta[o][j], gamma[o][j])
                last = voltage
                outputs[o, k] -= hysteretic[o][j] * z
    return outputs


def bouc_wen_amplitude(tip, beta, gamma):
    """Amplitude of the settled loop at whose tips z is -tip and tip: along it z falls to 0, then grows."""
    c, e = beta + gamma, beta - gamma
    return 0.5 * ((np.log1p(e * tip) / e if e else tip) - np.log1p(-c * tip) / c)


def relay_sum(u, low, high, weights, sub=1):
    """Preisach model as a plain sum of relays, all switched off at first: outputs (sample,).

    weights[a][b] (b <= a) is the weight of a cell of the plane over its width. It is spread over sub x sub
    relays; that of a cell of the diagonal, where a relay has no width, over sub relays on the diagonal.
    """
    n = len(weights)
    width, places = (high - low) / n, (np.arange(sub) + 0.5) / sub
    on_v, off_v, jump = [], [], []
    for a in range(n):
        for b in range(a + 1):
            pairs = [(s, s) for s in places] if a == b else [(s, q) for s in places for q in places]
            for s, q in pairs:
                on_v.append(low + (a + s) * width)
                off_v.append(low + (b + q) * width)
                jump.append(weights[a][b] * width / len(pairs))
    on_v, off_v, jump = np.array(on_v), np.array(off_v), np.array(jump)
    state, outputs = np.zeros(len(jump), dtype=bool), []
    for voltage in u:
        state = np.where(voltage >= on_v, True, np.where(voltage <= off_v, False, state))
        outputs.append(jump @ state)
    return np.array(outputs)
