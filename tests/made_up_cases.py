"""Actuators drawn at random, their records, and what an identification must reach on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import made_up
import numpy as np

from hammerstein.errors import HammersteinError
from hammerstein.identification.excitation import counted
from hammerstein.identification.identify import identify
from hammerstein.identification.score import score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import judged_starts
from hammerstein.records.record import Record

# Drives played on the true actuator -------------------------------------------------------------------------


def played_um(made, model, hz, cycles=3):
    """Rms error (output,) of a slow path in the middle of the reach, played on the true actuator [um].

    The actuator is driven to both ends of its range first, as ``--conditioned`` asks. None where the model
    refuses: it is flagged, or says that it cannot follow.
    """
    middle = [0.5 * (made.low_v + made.high_v)] * made.inputs
    samples = round(cycles * made.rate_hz / hz)
    asked = {"start_v": middle, "conditioned": True}
    try:
        still = model.compensate(np.zeros((made.outputs, samples)), law="exact_inverse", **asked)
        reach = np.array(still.reach.together_um)
        t = np.arange(samples) / made.rate_hz
        soft = np.minimum(t * hz, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(t * hz, 1.0))
        turns = 2.0 * np.pi * hz * t + 0.5 * np.pi * np.arange(made.outputs)[:, None]
        size = 0.5 * np.abs(reach).min(axis=1, keepdims=True)
        drive_v = model.compensate(size * soft * np.sin(turns), **asked).drive_v
    except HammersteinError:
        return None
    assert (drive_v >= made.low_v - 1e-9).all()
    assert (drive_v <= made.high_v + 1e-9).all()
    before = np.array([[made.high_v, made.low_v, middle[0]]] * made.inputs)
    held = np.repeat(np.array(middle)[:, None], round(0.2 * made.rate_hz), axis=1)
    position = made.position_um(np.hstack([held, drive_v]), before)[:, held.shape[1] - 1 :]
    error = position[:, 1:] - position[:, :1] - size * soft * np.sin(turns)
    return np.sqrt(np.mean(error**2, axis=1))


# Twenty stages ----------------------------------------------------------------------------------------------


def random_stage(seed):
    """Stage as in the issue: range, weights, resonances 80-900 Hz, damping 0.01-0.3, coupling 0-10 %."""
    g = np.random.default_rng([9, seed])
    span_v, span_um = g.uniform(40.0, 150.0), g.uniform(20.0, 120.0)
    low = float(g.choice([0.0, -0.5 * span_v, -0.2 * span_v]))
    return made_up.stage(
        seed,
        low_v=low,
        high_v=low + span_v,
        span_um=span_um,
        loop=g.uniform(0.08, 0.18),
        plays=int(g.integers(5, 41)),
        coupling=g.uniform(0.0, 0.1),
        resonances_hz=tuple(np.exp(g.uniform(np.log(80.0), np.log(900.0), 2))),
        damping=tuple(np.exp(g.uniform(np.log(0.01), np.log(0.3), 2))),
        noise_um=span_um / 8000.0,
    )


def record(made, u, generator, name, before_v=()):
    return Record(u, made.record(u, generator, before_v), 1.0 / made.rate_hz, source=name)


def stage_records(made, generator, **triangles):
    """Two with triangles of falling height, a sine on both axes, and one to validate with."""
    held = record(made, made_up.wander(made, generator), generator, "validation")
    fitted = [
        record(made, made_up.triangles(made, k, **triangles), generator, f"axis {k}")
        for k in range(made.inputs)
    ]
    return [*fitted, record(made, made_up.sine(made), generator, "sine")], held


@dataclass(frozen=True)
class StageOutcome:
    """What came out for one stage: held-out rms against what is allowed, resonances found or said unknown."""

    seed: int
    rms_um: tuple[float, ...]
    allowed_um: tuple[float, ...]
    resonance_errors: tuple[float | None, ...]
    said_unknown: tuple[bool, ...]
    kind: str
    circle_um: tuple[float, ...] | None

    @property
    def followed(self):
        return all(rms <= allowed for rms, allowed in zip(self.rms_um, self.allowed_um, strict=True))

    @property
    def drawn(self):
        """Whether a circle of 40 Hz on the true stage is off by at most three times what is allowed."""
        if self.circle_um is None:
            return False
        return all(rms <= 3.0 * allowed for rms, allowed in zip(self.circle_um, self.allowed_um, strict=True))

    @property
    def resonances_fine(self):
        return all(
            said or (error is not None and error <= 0.02)
            for error, said in zip(self.resonance_errors, self.said_unknown, strict=True)
        )


def try_stage(seed):
    made, generator = random_stage(seed), np.random.default_rng([10, seed])
    fitted, held = stage_records(made, generator)
    model, fit = identify(fitted, Settings(), validation=[held])
    circle = played_um(made, model, 40.0, 8)
    span = np.ptp(held.y_um, axis=1)
    errors, said = [], []
    for o, true_hz in enumerate(made.resonances_hz):
        found = fit.axes[o].axis.resonance_hz if fit.axes else None
        errors.append(None if found is None else abs(found / true_hz - 1.0))
        words = f"resonance and damping of {fit.outputs[o]}"
        said.append(any(text.startswith(words) for text in fit.not_identifiable))
    return StageOutcome(
        seed,
        fit.validation[fit.kind].rms_um,
        tuple((3.0 * made.noise_um + 0.0005 * span).tolist()),
        tuple(errors),
        tuple(said),
        fit.kind,
        None if circle is None else tuple(circle.tolist()),
    )


# Two hundred actuators --------------------------------------------------------------------------------------


def random_actuator(seed):
    """One axis of any kind, and the voltages that it went through before each of its three records."""
    g = np.random.default_rng([11, seed])
    span_v = g.uniform(10.0, 200.0)
    low = float(g.choice([0.0, -0.5 * span_v, -0.2 * span_v]))
    span_um = 10.0 ** g.uniform(0.0, 2.0)
    made = made_up.stage(
        seed,
        low_v=low,
        high_v=low + span_v,
        span_um=span_um,
        loop=g.uniform(0.0, 0.2),
        plays=int(g.integers(2, 41)),
        resonances_hz=None,
        rate_hz=float(g.choice([2e3, 5e3, 1e4])),
        noise_um=span_um * 10.0 ** g.uniform(-5.0, -2.5),
    )
    fields = {
        "thresholds_v": made.thresholds_v[:1],
        "weights_um_per_v": made.weights_um_per_v[:1, :1],
        "offset_um": float(g.choice([0.0, g.uniform(-50.0, 50.0)])),
        "bend": float(g.choice([0.0, g.uniform(-0.1, 0.1)])),
    }
    kind = g.choice(["static", "lag", "resonance", "both"])
    if kind in ("lag", "both"):
        fields["lag_s"] = 10.0 ** g.uniform(-4.0, -2.5)
    if kind in ("resonance", "both"):
        fields["resonances_hz"] = (made.rate_hz * 10.0 ** g.uniform(-2.0, -0.8),)
        fields["damping"] = (10.0 ** g.uniform(-2.0, -0.5),)
    if g.random() < 0.3:
        fields["creep"] = ((g.uniform(0.01, 0.1), g.uniform(0.05, 0.5)),)
    made = replace(made, **fields)
    before = [g.uniform(low, low + span_v, (1, 4)) if g.random() < 0.5 else () for _ in range(3)]
    return made, before


@dataclass(frozen=True)
class ActuatorOutcome:
    """Error on a record that neither fit nor choice has seen: of the model kept, and of the simpler ones."""

    seed: int
    kind: str
    kept_percent: float
    least_simpler_percent: float
    played_um: float | None
    allowed_um: float

    @property
    def ratio(self):
        return self.kept_percent / self.least_simpler_percent

    @property
    def played(self):
        """Whether the drive leaves at most three times the error held back, and noise; None if refused."""
        return None if self.played_um is None else self.played_um <= self.allowed_um


def ringing_s(dynamics):
    """Time in which the resonance of a model, if any, rings down to a thousandth."""
    axes = [axis for axis in getattr(dynamics, "axes", ()) if axis.resonance_hz is not None]
    rates = [2.0 * np.pi * axis.resonance_hz * axis.damping_ratio for axis in axes]
    return np.log(1e3) / min(rates) if rates else 0.0


def try_actuator(seed):
    made, before = random_actuator(seed)
    g = np.random.default_rng([12, seed])
    u = [
        made_up.triangles(made, 0, cycles=4, hz=4.0),
        made_up.wander(made, g, 0.6, 1.0, 30.0),
        made_up.wander(made, g, 0.6, 1.0, 30.0),
    ]
    fitted, held, unseen = (
        record(made, one, g, name, past) for one, name, past in zip(u, "fhu", before, strict=True)
    )
    second = record(made, made_up.wander(made, g, 0.6), g, "s", before[0])
    model, fit = identify([fitted, second], Settings(), validation=[held])
    played = played_um(made, model, 5.0)
    allowed = 3.0 * fit.validation[fit.kind].rms_um[0] + made.noise_um
    kept, unseen = fit.candidates[fit.kind], counted(unseen)
    starts = judged_starts([unseen], kept.predict, ringing_s(kept.dynamics))
    errors = {kind: score(c, [unseen], starts).mean_percent for kind, c in fit.candidates.items()}
    order = ("linear", "static_hysteresis", "linear_dynamics", "hammerstein")
    simpler = [errors[k] for k in order[: order.index(fit.kind)] if k in errors] or [errors[fit.kind]]
    return ActuatorOutcome(
        seed,
        fit.kind,
        errors[fit.kind],
        min(simpler),
        None if played is None else float(played[0]),
        float(allowed),
    )
