"""The same work done by others: textbook loops, NumPy, python-control.

The compiled textbook loops are written for two outputs and without a function call, in the two orders that
were the quickest of those tried (time or operators outside, one or five operators at once, with and without
blocks). Each is compiled strictly and with fast-math, which lets the compiler reorder the weighted sums.
"""

from __future__ import annotations

import control
import numpy as np
from numba import njit
from ratios import Work, quickest

from hammerstein.dynamics import discretise

BLOCK = 1024


def _time_outside(u, r, w, plays, y):
    """All operators in each sample, vectorised over the operators; w : (m, 2, n)."""
    for t in range(u.shape[1]):
        first = second = 0.0
        for k in range(u.shape[0]):
            v = u[k, t]
            for i in range(r.shape[1]):
                play = max(v - r[k, i], min(v + r[k, i], plays[k, i]))
                plays[k, i] = play
                first += w[k, 0, i] * play
                second += w[k, 1, i] * play
        y[0, t] = first
        y[1, t] = second


def _operators_outside(u, r, w, plays, y):
    """Five operators at a time, in registers, through a block of samples that stays in the cache."""
    y[:] = 0.0
    for start in range(0, u.shape[1], BLOCK):
        stop = min(start + BLOCK, u.shape[1])
        for k in range(u.shape[0]):
            for i in range(0, r.shape[1], 5):
                ra, rb, rc, rd, re = r[k, i], r[k, i + 1], r[k, i + 2], r[k, i + 3], r[k, i + 4]
                p = plays[k, i : i + 5]
                a, b, c, d, e = p[0], p[1], p[2], p[3], p[4]
                w0, w1 = w[k, 0, i : i + 5], w[k, 1, i : i + 5]
                w0a, w0b, w0c, w0d, w0e = w0[0], w0[1], w0[2], w0[3], w0[4]
                w1a, w1b, w1c, w1d, w1e = w1[0], w1[1], w1[2], w1[3], w1[4]
                for t in range(start, stop):
                    v = u[k, t]
                    a = max(v - ra, min(v + ra, a))
                    b = max(v - rb, min(v + rb, b))
                    c = max(v - rc, min(v + rc, c))
                    d = max(v - rd, min(v + rd, d))
                    e = max(v - re, min(v + re, e))
                    y[0, t] += w0a * a + w0b * b + w0c * c + w0d * d + w0e * e
                    y[1, t] += w1a * a + w1b * b + w1c * c + w1d * d + w1e * e
                p[0], p[1], p[2], p[3], p[4] = a, b, c, d, e


FAST = ", fast-math"
# Not cached: Numba's cache does not tell a strict function from its fast-math twin.
COMPILED = {
    f"{name}{FAST if fast else ''}": njit(loop, fastmath=fast)
    for name, loop in (("time outside", _time_outside), ("operators outside", _operators_outside))
    for fast in (False, True)
}


def best_textbook(model, u, strict=False) -> tuple[str, Work]:
    """The quickest compiled textbook loop for this model and signal, checked against the model first."""
    bank = model.bank
    assert model.n_outputs == 2
    assert bank.r.shape[1] % 5 == 0
    w = np.ascontiguousarray(bank.w.transpose(0, 2, 1))
    expected = model.respond(u)[0]
    works = {}
    for name, loop in COMPILED.items():
        if strict and FAST in name:
            continue

        def respond(loop=loop):
            y = np.empty((2, u.shape[1]))
            loop(u, bank.r, w, np.zeros_like(bank.r), y)
            return y

        np.testing.assert_allclose(respond(), expected, rtol=0, atol=1e-10)
        works[name] = Work(respond, u.shape[1])
    return quickest(works)


def numpy_loop(model, u):
    """A loop over the samples, every operator of every input at once in NumPy."""
    bank = model.bank
    r = bank.r.ravel()
    w = bank.w.reshape(-1, model.n_outputs).T
    plays, y = np.zeros_like(r), np.empty((model.n_outputs, u.shape[1]))
    repeated = np.repeat(u, bank.r.shape[1], axis=0)
    for t in range(u.shape[1]):
        v = repeated[:, t]
        plays = np.maximum(v - r, np.minimum(v + r, plays))
        y[:, t] = w @ plays
    return y


def backlash_objects(model, u):
    """One python-control backlash object an operator, called sample by sample."""
    y = np.zeros((model.n_outputs, u.shape[1]))
    for row, outputs in zip(model.pairs, y, strict=True):
        for k, pair in enumerate(row):
            for r, weight in zip(pair.thresholds_v, pair.weights_um_per_v, strict=True):
                backlash = control.friction_backlash_nonlinearity(2.0 * r)
                outputs += weight * np.array([backlash(v) for v in u[k]])
    return y


def textbook_plays(model, dt, name):
    """Equation 1 for all operators at once as a python-control system; states are the plays.

    Inputs are ``u[0]`` .., outputs ``v[0]`` .., states input by input.
    """
    r = [
        np.unique(np.concatenate([row[k].thresholds_v for row in model.pairs])) for k in range(model.n_inputs)
    ]
    of_input, thresholds = np.repeat(np.arange(model.n_inputs), [len(x) for x in r]), np.concatenate(r)
    weights = np.zeros((model.n_outputs, len(thresholds)))
    for o, row in enumerate(model.pairs):
        for k, pair in enumerate(row):
            places = np.flatnonzero(of_input == k)[np.searchsorted(r[k], pair.thresholds_v)]
            weights[o, places] = pair.weights_um_per_v

    def plays(t, x, u, params):
        v = np.atleast_1d(u)[of_input]
        return np.maximum(v - thresholds, np.minimum(v + thresholds, x))

    def outputs(t, x, u, params):
        return weights @ plays(t, x, u, params)

    names = {"inputs": _labels("u", model.n_inputs), "outputs": _labels("v", model.n_outputs)}
    return control.nlsys(plays, outputs, **names, states=len(thresholds), dt=dt, name=name)


def hysteresis_and_dynamics(model, dt):
    """The model as a block diagram: its hysteresis, then its dynamics on the sample grid."""
    block = discretise(model.dynamics, dt)
    gamma = textbook_plays(model.hysteresis, dt, name="gamma")
    linear = _linear(block)
    axes = range(model.hysteresis.n_outputs)
    return control.interconnect(
        [gamma, linear],
        connections=[[f"linear.v[{o}]", f"gamma.v[{o}]"] for o in axes],
        inplist=[f"gamma.u[{k}]" for k in range(model.hysteresis.n_inputs)],
        outlist=[f"linear.y[{o}]" for o in axes],
        dt=dt,
    )


def experiment_diagram(plant, law):
    """The whole bench as a block diagram: law, drive, hysteresis, dynamics with the sensor's lag, sensor.

    Inputs: reference of each axis [um], then the sensor's noise in units of its rms. Outputs: readings [um].
    """
    dt, axes = plant.sample_time_s, range(2)
    systems = [
        _law(law, dt),
        _drive(plant.instruments.drive, dt),
        textbook_plays(plant.model.hysteresis, dt, name="gamma"),
        _linear(plant.block),
        _sensor(plant.instruments.sensor, dt),
    ]
    wires = [[f"drive.u[{k}]", f"law.u[{k}]"] for k in axes]
    wires += [[f"gamma.u[{k}]", f"drive.held[{k}]"] for k in axes]
    wires += [[f"linear.v[{k}]", f"gamma.v[{k}]"] for k in axes]
    wires += [[f"sensor.y[{k}]", f"linear.y[{k + 2}]"] for k in axes]
    return control.interconnect(
        systems,
        connections=wires,
        inplist=[f"law.wanted[{k}]" for k in axes] + [f"sensor.noise[{k}]" for k in axes],
        outlist=[f"sensor.reading[{k}]" for k in axes],
        ignore_outputs=[f"linear.y[{k}]" for k in axes],
        dt=dt,
    )


def _linear(block):
    names = {"inputs": _labels("v", block.n_inputs), "outputs": _labels("y", block.n_outputs)}
    return control.ss(block.A, block.B, block.C, block.D, block.sample_time_s, name="linear", **names)


def _labels(name, n):
    return [f"{name}[{i}]" for i in range(n)]


def _law(law, dt):
    """Theorem 4.1 with one-sample delay: states are the plays of its model, then its feedback."""
    gamma = textbook_plays(law.hysteresis, dt, name="inside the law")
    gain, (low, high), n = law.gain_v_per_um, law.range.counted, gamma.nstates

    def drive(t, x, wanted, params):
        return np.clip(gain @ wanted + x[n:], low, high)

    def update(t, x, wanted, params):
        u = drive(t, x, wanted, params)
        left = u - gain @ gamma.output(t, x[:n], u)
        return np.concatenate([gamma.dynamics(t, x[:n], u), law.pole * x[n:] + (1.0 - law.pole) * left])

    names = {"inputs": _labels("wanted", 2), "outputs": _labels("u", 2)}
    return control.nlsys(update, drive, **names, states=n + 2, dt=dt, name="law")


def _drive(drive, dt):
    def held(t, x, u, params):
        clipped = np.clip(u, *drive.range_v)
        return np.round(clipped / drive.resolution_v) * drive.resolution_v

    names = {"inputs": _labels("u", 2), "outputs": _labels("held", 2)}
    return control.nlsys(None, held, **names, dt=dt, name="drive")


def _sensor(sensor, dt):
    def reading(t, x, wires, params):
        noisy = np.clip(wires[:2] + sensor.noise_um * wires[2:], -sensor.range_um, sensor.range_um)
        return np.round(noisy / sensor.resolution_um) * sensor.resolution_um

    names = {"inputs": _labels("y", 2) + _labels("noise", 2), "outputs": _labels("reading", 2)}
    return control.nlsys(None, reading, **names, dt=dt, name="sensor")
