"""One actuator: identified with the defaults, and judged by what is known of it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hammerstein.errors import HammersteinError, InputError
from hammerstein.identification.identify import from_last_rest, identify
from hammerstein.identification.score import score
from hammerstein.identification.settings import Settings
from hammerstein.identification.static.initial_state import judged_starts
from hammerstein.records.reading import read_records
from hammerstein.records.record import Record

from .truth import LAWS, LINEAR, SHAPES, actuator, voltages

JITTER = 0.02
"""Standard deviation of a time stamp, in parts of the sample time."""
OTHERS = 6
"""Further records beside the one that judges: how much the errors of a model differ between records."""
SURE = 3.0
"""Standard errors within which a stated number lies."""


@dataclass(frozen=True)
class Outcome:
    """What was said of an actuator, and what is true.

    stated_um, true_um : rms errors (output,) on the validation record, and on a further one like it
    others_um : (record, output) the same on more records of that kind
    best_um : mean error there of the best candidate, chosen_um of the chosen one
    stated, missed : numbers of its linear part that are stated, and those off by more than 3 standard errors
    """

    seed: int
    what: str
    shape: str
    kind: str = ""
    stated_um: tuple[float, ...] = ()
    true_um: tuple[float, ...] = ()
    others_um: tuple[tuple[float, ...], ...] = ()
    chosen_um: float = 0.0
    best_um: float = 0.0
    best: str = ""
    stated: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()
    refused: str = ""

    @property
    def honest(self):
        """Whether the stated error is within 0.7 to 1.5 times the true one, of every output."""
        return _alike(self.stated_um, self.true_um)

    @property
    def alike(self):
        """The same of the error on another further record in place of the stated one: chance alone."""
        return _alike(self.others_um[0], self.true_um)

    @property
    def foreseen(self):
        """The same of the rms of all those: what the best possible statement reaches."""
        return _alike(np.sqrt(np.mean(np.square(self.others_um), axis=0)), self.true_um)

    @property
    def best_chosen(self):
        """Whether the chosen candidate is within 10 % of the best one."""
        return self.chosen_um <= 1.1 * self.best_um


def _alike(stated_um, true_um):
    ratios = np.array(stated_um) / np.array(true_um)
    return bool(((ratios >= 0.7) & (ratios <= 1.5)).all())


def tried(seed, settings=None):
    """Identify the actuator of a seed; a refusal is an outcome, too."""
    shape = SHAPES[(seed // len(LAWS) // len(LINEAR) + seed) % len(SHAPES)]
    made, g = actuator(seed, shape), np.random.default_rng([32, seed])
    fitted, held, further = voltages(made, shape, g)
    linear = "creep " * bool(made.creep) + "resonance " * bool(made.resonances_hz) + "lag " * bool(made.lag_s)
    what = f"{LAWS[seed % len(LAWS)]}, {linear.strip() or 'static'}, {made.inputs} axes"
    try:
        *records, validation, more = _recorded(made, [*fitted, held, further], g, shape)
        _, fit = identify(records, settings or Settings(), validation=[validation])
    except HammersteinError as error:
        return Outcome(seed, what, shape, refused=str(error)[:300])
    errors = _errors(fit, more)
    others = _others(made, fit, shape, seed)
    best = min(errors, key=lambda kind: sum(errors[kind]))
    stated, missed = _numbers(made, fit)
    return Outcome(
        seed, what, shape, fit.kind, tuple(map(float, fit.validation[fit.kind].rms_um)),
        tuple(map(float, errors[fit.kind])), others, float(np.mean(errors[fit.kind])),
        float(np.mean(errors[best])), best, tuple(stated), tuple(missed),
    )  # fmt: skip


def _errors(fit, record):
    """Rms errors [um] of all candidates on a record, judged as a validation record is."""
    ready, kept = from_last_rest([record], accept_order=True), fit.candidates[fit.kind]
    simpler = [one.predict for one in fit.candidates.values() if one is not kept]
    begun = judged_starts(ready, kept.predict, kept.settle_s, simpler=simpler, slow_s=kept.slow_s)
    return {
        name: score(one, ready, one.own_starts(ready, begun)).rms_um for name, one in fit.candidates.items()
    }


def _others(made, fit, shape, seed):
    """Errors (record, output) of the chosen model on ``OTHERS`` further records."""
    g, found = np.random.default_rng([33, seed]), []
    for _ in range(OTHERS // 2):
        sent = voltages(made, shape, g)[1:]
        found += _recorded(made, sent, g, shape)
    return tuple(tuple(map(float, _errors(fit, one)[fit.kind])) for one in found)


def _recorded(made, sent, g, shape):
    """Records of all voltages, the last two the validation record and the further one."""
    names = [*(f"fitted {i}" for i in range(len(sent) - 2)), "validation", "further"]
    free = shape == "after any history"
    past = [g.uniform(made.low_v, made.high_v, (made.inputs, 4)) if free else () for _ in sent]
    read = [made.record(u, g, before) for u, before in zip(sent, past, strict=True)]
    if shape == "jittered clock":
        return _by_files(made, sent, read, names, g)
    rows = zip(sent, read, names, strict=True)
    return [Record(u, y, 1.0 / made.rate_hz, source=name) for u, y, name in rows]


def _by_files(made, sent, read, names, g):
    """The same through files whose time stamps are not even."""
    inputs, outputs = ([f"{q}{k}" for k in range(made.inputs)] for q in "uy")
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"{name}.csv" for name in names]
        for file, u, y in zip(files, sent, read, strict=True):
            t = (np.arange(u.shape[1]) + JITTER * g.standard_normal(u.shape[1])) / made.rate_hz
            head = ",".join(["t", *inputs, *outputs])
            np.savetxt(file, np.vstack([t, u, y]).T, delimiter=",", header=head, comments="")
        try:
            return read_records(files, inputs=inputs, outputs=outputs, time="t")
        except InputError as error:  # stamps too uneven for a clock
            if "give --rate if the sampling was uniform" not in str(error):  # the remedy
                raise
            return read_records(files, inputs=inputs, outputs=outputs, rate_hz=made.rate_hz)


def _numbers(made, fit):
    """Numbers of the linear part that are stated as known, and those that miss the truth."""
    stated, missed = [], []
    for o, one in enumerate(fit.axes):
        axis, output = one.axis, fit.outputs[o]
        hz = (made.resonances_hz or (None,) * len(fit.axes))[o]
        damping = made.damping[o] if made.damping else None
        rows = [
            ("resonance", axis.resonance_hz, one.resonance_error_percent, hz),
            ("damping", axis.damping_ratio, one.damping_error_percent, damping),
            ("lag", axis.lag_s, one.lag_error_percent, made.lag_s or None),
        ]
        for name, value, percent, true in rows:
            unknown = any(name in said and f"of {output}" in said for said in fit.not_identifiable)
            if value is None or percent is None or unknown or not one.identified:
                continue
            stated.append(f"{name} of {output}")
            error = 0.01 * percent * value
            if true is None or abs(value - true) > SURE * error:
                missed.append(f"{name} of {output}: {value:.4g} +- {error:.2g}, true {true}")
    return stated, missed
