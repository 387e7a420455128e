"""Actuators and records drawn at random, in plain NumPy and SciPy; imports nothing of ours.

The hysteresis is one of five laws, none of them fitted to what identification can represent. Sources: stops,
Goldfarb and Celanovic, IEEE Control Systems 17(3), 1997; Bouc-Wen, Wen, J. Eng. Mech. 102, 1976; relays,
Mayergoyz, Mathematical Models of Hysteresis, 1991; plays of an envelope, Al Janaideh et al., 2011.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import made_up
import numpy as np

LAWS = ("plays", "stops", "bouc_wen", "relays", "envelope")
SHAPES = (
    *("several rates", "after any history", "ring and hold", "two-level noise", "multisine"),
    *("jittered clock", "square law", "one rate"),
)
LINEAR = ("static", "lag", "resonance", "resonance and creep")


@dataclass(frozen=True, eq=False)
class Actuator(made_up.MadeUp):
    """An actuator whose hysteresis is any law of its voltages in parts of the range (0 to 1).

    laws : (output) (input), each from (sample,) to (sample,); gains_um : (output, input) travel
    """

    laws: tuple[tuple[Callable[[np.ndarray], np.ndarray], ...], ...] = ()
    gains_um: np.ndarray | None = None
    power: float = 1.0

    def static_um(self, u, before_v=()):
        past = np.reshape(np.asarray(before_v, dtype=float), (self.inputs, -1))
        sent = np.hstack([np.full((self.inputs, 1), self.low_v), past, u])
        v = (sent - self.low_v) / (self.high_v - self.low_v)
        y = [
            sum(
                gain * np.sign(h) * np.abs(h) ** self.power
                for gain, h in zip(gains, (law(row) for law, row in zip(laws, v, strict=True)), strict=True)
            )
            for gains, laws in zip(self.gains_um, self.laws, strict=True)
        ]
        return np.array(y)[:, 1 + past.shape[1] :]


def law(name, g):
    """A law of one voltage from the state that it has at its lowest one."""
    if name == "plays":
        r, share = g.uniform(0.0, 0.4, g.integers(2, 30)), g.uniform(0.1, 0.4)
        return lambda v: (1.0 - share) * v + share * np.mean([_play(v, one) for one in r], axis=0)
    if name == "stops":
        r = np.geomspace(0.003, 0.6, 30)
        w = r ** g.uniform(0.2, 0.8) * np.exp(-r / g.uniform(0.1, 0.5))
        w *= g.uniform(0.15, 0.4) / w.sum()
        return lambda v: v - w @ np.array([v - _play(v, one) for one in r])
    if name == "bouc_wen":
        a, b = g.uniform(0.15, 0.35), g.uniform(2.0, 8.0)
        c = b * g.uniform(-0.3, 0.6)
        return lambda v: v - _bouc_wen(v, a, b, c)
    if name == "relays":
        n, width, tilt = 50, g.uniform(0.1, 0.3), g.uniform(1.0, 3.0)
        up, down = np.meshgrid(np.linspace(0.01, 0.99, n), np.linspace(0.0, 0.98, n), indexing="ij")
        kept = up > down
        up, down = up[kept], down[kept]
        w = np.exp(-(up - down) / width) * (1.0 + 0.4 * np.cos(tilt * (up + down)))
        share, jitter = g.uniform(0.2, 0.7), 0.01 * g.uniform(-1.0, 1.0, up.size)
        return lambda v: (1.0 - share) * v + share * _relays(v, up + jitter, down + jitter, w / w.sum())
    bend, r, share = g.uniform(-1.0, 1.0), g.uniform(0.0, 0.4, 15), g.uniform(0.1, 0.4)
    return lambda v: _envelope((1 - share) * v + share * np.mean([_play(v, one) for one in r], axis=0), bend)


def _play(v, r):
    out, last = np.empty_like(v), 0.0
    for k, value in enumerate(v.tolist()):
        last = max(value - r, min(value + r, last))
        out[k] = last
    return out


def _bouc_wen(v, a, b, c):
    """h' = a u' - b |u'| h - c u' |h|, in steps of a 400th of the range."""
    out, last, h = np.empty_like(v), float(v[0]), 0.0
    for k, value in enumerate(v.tolist()):
        steps = max(1, int(abs(value - last) * 400))
        move = (value - last) / steps
        for _ in range(steps):
            h += move * a - b * abs(move) * h - c * move * abs(h)
        out[k], last = h, value
    return out


def _relays(v, up, down, w):
    state, out = np.zeros(up.size), np.empty_like(v)
    y, last = 0.0, None
    for k, value in enumerate(v.tolist()):
        if value != last:
            state[value >= up], state[value <= down] = 1.0, 0.0
            y, last = float(w @ state), value
        out[k] = y
    return out


def _envelope(v, bend):
    return np.expm1(bend * v) / np.expm1(bend)


def actuator(seed, shape):
    """One or two axes of any law and any linear part, with a sensor."""
    g = np.random.default_rng([31, seed])
    axes, rate_hz = int(g.integers(1, 3)), float(g.choice([2e3, 5e3]))
    name = LAWS[seed % len(LAWS)]
    low_v, high_v = ((0.0, 100.0), (-10.0, 10.0), (0.0, 150.0))[g.integers(3)]
    travel_um = np.exp(g.uniform(np.log(5.0), np.log(100.0)))
    gains = travel_um * np.where(np.eye(axes) > 0, 1.0, g.uniform(-0.1, 0.1, (axes, axes)))
    fields = {"offset_um": g.uniform(-50.0, 50.0), "noise_um": travel_um * 10.0 ** g.uniform(-4.3, -3.0)}
    kind = "static" if shape == "one rate" else LINEAR[(seed // len(LAWS)) % len(LINEAR)]
    if kind == "lag":
        fields["lag_s"] = 10.0 ** g.uniform(-3.3, -2.3)
    if kind.startswith("resonance"):
        fields["resonances_hz"] = tuple(rate_hz * 10.0 ** g.uniform(-1.7, -0.9, axes))
        fields["damping"] = tuple(10.0 ** g.uniform(-2.0, -0.7, axes))
    if kind.endswith("creep"):
        fields["creep"] = ((g.uniform(0.02, 0.08), g.uniform(0.1, 0.5)),)
    laws = tuple(tuple(law(name, g) for _ in range(axes)) for _ in range(axes))
    nothing = np.zeros((axes, 1)), np.zeros((axes, axes, 1))
    made = Actuator(*nothing, low_v, high_v, rate_hz, laws=laws, gains_um=gains, **fields)
    return replace(made, power=2.0) if shape == "square law" else made


def voltages(made, shape, g):
    """Voltages (input, sample) of the fitted records, of the validation record, and of a further one."""
    if shape == "ring and hold":
        each = [_held_first(made, made_up.triangles(made, k, 4, 3.0), g) for k in range(made.inputs)]
        each.append(_held_first(made, made_up.wander(made, g, 1.5, 1.0, 40.0), g))
        return each, *(_held_first(made, made_up.wander(made, g, 1.5, 1.0, 40.0), g) for _ in range(2))
    if shape == "two-level noise":
        slow = [made_up.triangles(made, k, 4, 3.0) for k in range(made.inputs)]
        return [*slow, *(_two_levels(made, g) for _ in range(2))], _two_levels(made, g), _two_levels(made, g)
    if shape == "multisine":
        each = [made_up.wander(made, g, 2.0, 1.0, 60.0, share=share) for share in (0.9, 0.6, 0.3)]
        return each, *(made_up.wander(made, g, 2.0, 1.0, 60.0) for _ in range(2))
    if shape == "one rate":
        falling = [made_up.triangles(made, k, 6, 5.0, 0.1) for k in range(made.inputs)]
        other = [_modulated(made, g) for _ in range(3)]
        return [*falling, other[0]], *other[1:]
    slow = [made_up.triangles(made, k, 5, 4.0) for k in range(made.inputs)]
    fast = [made_up.sine(made, 20.0)[: made.inputs], made_up.wander(made, g, 1.0, 5.0, 0.05 * made.rate_hz)]
    return [*slow, *fast], *(made_up.wander(made, g, 1.0, 1.0, 40.0) for _ in range(2))


def _held_first(made, u, g):
    """A step from the lowest voltage, a hold of 1.5 s, then what is asked for from there."""
    held = np.repeat(made.low_v + g.uniform(0.0, 0.9, (made.inputs, 1)) * (made.high_v - made.low_v),
                     round(1.5 * made.rate_hz), axis=1)  # fmt: skip
    soft = np.minimum(np.arange(u.shape[1]) / (0.1 * made.rate_hz), 1.0)
    return np.hstack([u[:, :1] * 0.0 + made.low_v, held, held[:, :1] * (1.0 - soft) + u * soft])


def _two_levels(made, g):
    """Maximum-length noise of a clock of a 20th of the sample rate, between a quarter and three quarters."""
    bits = g.integers(0, 2, (made.inputs, 100))
    u = made.low_v + (0.25 + 0.5 * np.repeat(bits, 20, axis=1)) * (made.high_v - made.low_v)
    return np.hstack([np.full((made.inputs, 20), made.low_v), u])


def _modulated(made, g):
    """A sine of 5 Hz whose amplitude wanders, from the lowest voltage."""
    t = np.arange(round(2.0 * made.rate_hz)) / made.rate_hz
    rows = []
    for _ in range(made.inputs):
        top = np.interp(t, np.linspace(0.0, 2.0, 6), g.uniform(0.2, 0.95, 6)) * np.minimum(5.0 * t, 1.0)
        rows.append(top * 0.5 * (1.0 - np.cos(2.0 * np.pi * 5.0 * t)))
    return made.low_v + (made.high_v - made.low_v) * np.array(rows)
