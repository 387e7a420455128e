"""Compiled loops of a law that reads the sensor: one step of the controller, and the whole closed loop."""

import numpy as np

from hammerstein.blocks.instrument_kernels import converted
from hammerstein.compiled import compiled
from hammerstein.dynamics.path_kernel import linear_step
from hammerstein.hysteresis.play_kernels import BUSY, GROUP, load, plays_of, respond_block, stack_of

# Columns of the controller's memory, a row an output: the last reference, what the sensor should read, the
# integral, the last error, and the correction for the next sample.
REFERENCE, SEEN, INTEGRAL, ERROR, CORRECTION = range(5)
# Columns of its settings, a row an output: the sensor's lag (pole, and the two shares of a reference that is
# straight between samples), then the gains for one sample.
POLE, OLD, NEW, PROPORTIONAL, INTEGRATING, DERIVATIVE = range(6)


@compiled()
def correct(reference, reading, settings, memory):  # type: ignore[no-untyped-def]
    """One step of the controller: from reference and reading (p,) of a sample to the next correction."""
    for o in range(memory.shape[0]):
        seen = settings[o, POLE] * memory[o, SEEN] + settings[o, OLD] * memory[o, REFERENCE]
        seen += settings[o, NEW] * reference[o]
        error = seen - reading[o]
        memory[o, INTEGRAL] += settings[o, INTEGRATING] * error
        change = settings[o, DERIVATIVE] * (error - memory[o, ERROR])
        memory[o, CORRECTION] = settings[o, PROPORTIONAL] * error + memory[o, INTEGRAL] + change
        memory[o, REFERENCE], memory[o, SEEN], memory[o, ERROR] = reference[o], seen, error


@compiled()
def request(feedforward, inverse_gain, gain, limits, memory, requested):  # type: ignore[no-untyped-def]
    """Voltages (m,) for the correction in the memory, added to a feedforward (m,).

    What the range (limits: low and high, (2, m)) cuts off is removed from the integral (back-calculation), in
    um through the gain matrix.
    """
    for k in range(requested.shape[0]):
        requested[k] = feedforward[k]
        for o in range(memory.shape[0]):
            requested[k] += inverse_gain[k, o] * memory[o, CORRECTION]
    for k in range(requested.shape[0]):
        cut = min(max(requested[k], limits[0, k]), limits[1, k]) - requested[k]
        for o in range(memory.shape[0]):
            memory[o, INTEGRAL] += gain[o, k] * cut


@compiled()
def run_closed_loop(signals, controller, instruments, actuator, first, stop, out, outputs):  # type: ignore[no-untyped-def]
    """Controller, drive, hysteresis, linear block and sensor, sample by sample.

    signals : reference (p, N), feedforward (m, N) and noise (p, N)
    controller : settings and memory, see above, inverse gain (m, p), gain (p, m), limits (2, m)
    instruments : step of the drive [V], with range, step and noise of the sensor [um]; lowest and highest
        step (2, m) of the converter; working point (m,) of the hysteresis [V]
    actuator : bank and plays, see ``respond_turning_points`` (as for outputs); rows and state of the linear
        block, positions first
    out : requested and drive (m, N); hysteresis, position, reading (p, N), overwritten from first up to stop
    """
    settings, inverse_gain, gain, limits, memory = controller
    reference, feedforward, noise = signals
    effects, steps, rest = instruments
    (r, guide, scale, n, lines, w), (count, end, x, d, window), ((start, column, value), state) = actuator
    requested, drive, hysteresis, position, reading = out
    m, p = drive.shape[0], reading.shape[0]
    tall = r.shape[1] + 2
    ends, xs, ds = np.empty((m, tall), np.int64), np.empty((m, tall)), np.empty((m, tall))
    tips, positions, kept = np.empty((m, tall, p)), np.empty((m, tall)), np.empty((GROUP, 1))
    for k in range(m):
        load(n[k], lines[k], count[k], end[k], x[k], d[k], ends[k], xs[k], ds[k], tips[k], outputs)
        plays_of(r[k], count[k], ends[k], xs[k], ds[k], positions[k])
    counted, v = np.empty((m, 1)), np.empty((p, 1))
    asked, both, now, read = np.empty(m), np.empty((2 * p, 1)), np.empty(p), np.empty(p)
    order = state.shape[0]
    z, new = np.empty(order + p), np.empty(order + p)
    z[:order] = state
    for t in range(first, stop):
        request(feedforward[:, t], inverse_gain, gain, limits, memory, asked)
        v[:] = 0.0
        for k in range(m):
            requested[k, t] = asked[k]
            drive[k, t] = converted(asked[k], steps[0, k], steps[1, k], effects[0])
            counted[k, 0] = drive[k, t] - rest[k]
            if n[k] > 0:
                count[k] = respond_block(
                    counted[k], 0, 1, r[k], guide[k], scale[k], lines[k], w[k], count[k],
                    ends[k], xs[k], ds[k], tips[k], positions[k], window[k], kept, v, outputs,
                )  # fmt: skip
        z[order:] = v[:, 0]
        linear_step(start, column, value, z, new, order, 0, both)
        z, new = new, z
        for o in range(p):
            hysteresis[o, t], position[o, t] = v[o, 0], both[o, 0]
            noisy = both[p + o, 0] + effects[3] * noise[o, t]
            read[o] = converted(noisy, -effects[1], effects[1], effects[2])
            reading[o, t], now[o] = read[o], reference[o, t]
        correct(now, read, settings, memory)
    state[:] = z[:order]
    for k in range(m):
        if window[k, BUSY]:
            count[k] = stack_of(positions[k], lines[k], ends[k], xs[k], ds[k], tips[k], outputs)
        for s in range(count[k]):
            end[k, s], x[k, s], d[k, s] = ends[k, s + 1], xs[k, s + 1], ds[k, s + 1]
