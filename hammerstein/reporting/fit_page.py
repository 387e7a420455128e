"""The account of an identification as a page for people and as JSON for programs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePath

import numpy as np

from hammerstein.escaping import markdown
from hammerstein.experiment.selection import percent
from hammerstein.hysteresis import PrandtlIshlinskii, slopes_of
from hammerstein.identification.choice import Trial
from hammerstein.identification.fit import KIND_NAMES, Fit, Kind
from hammerstein.identification.score import Score
from hammerstein.model import HammersteinModel

CAPTIONS = {
    "loops": "One cycle of each input, measured and by the model (dark, broken). Of an input that only moves "
    "together with others, what the model says of the others is taken off what was measured.",
    "residual": "What each kind of model leaves: over time, and the largest amplitude in bands of frequency.",
    "operators": "Error on stretches of the records that were held out, against the number of operators. The "
    "grey bar marks this model.",
    "response": "Gain of each pair, measured and by the model at the amplitude of the records, and the part "
    "of each output's power that the inputs explain linearly.",
}


BEGINNINGS = {
    "rest": "from rest",
    "stepped": "with a step from 0 V",
    "turned": "after the voltages had turned at",
    "repeated": "in motion",
}


def fit_json(model: HammersteinModel, fit: Fit) -> str:
    """Everything about a fit as one JSON object: full precision, sorted keys, equal fits give equal bytes."""
    plain = fit.as_dict() | {
        "model": model.name,
        "dynamics": model.dynamics.model_dump(mode="json"),
        "records": [PurePath(record.source).name for record in fit.records],
        "held_records": [PurePath(record.source).name for record in fit.held],
    }
    return json.dumps(plain, indent=1, sort_keys=True, allow_nan=False) + "\n"


def fit_page(model: HammersteinModel, fit: Fit, figures: Sequence[str] = ()) -> str:
    """Markdown page of a fit; equal fits give equal bytes.

    Parameters
    ----------
    model, fit : what ``identify`` gave
    figures : names of PNG files beside the page
    """
    parts = [
        f"# Fit report of {markdown(model.name)}",
        markdown(headline(model, fit)),
        markdown(fit.verdict),
        fit_body(model, fit),
        *(["## Figures", *_pictures(figures)] if figures else []),
        "Every number with full precision is in `fit.json`.",
    ]
    return "\n\n".join(parts) + "\n"


def headline(model: HammersteinModel, fit: Fit) -> str:
    """How far the model is off, in one sentence."""
    score = fit.judged[fit.kind]
    shares, rms = score.nrmse_percent, score.rms_um
    off = " and ".join(
        f"{um:.3g} um of {name} ({percent(share / 100.0)} of its range)"
        for name, um, share in zip(fit.outputs, rms, shares, strict=True)
    )
    where = (
        "on records that it was not fitted to"
        if fit.validation
        else "on the records that it was fitted to; none was held back"
    )
    warned = " It cannot represent all that they hold: see below." if fit.flags else ""
    return f"The model {model.name} is off by {off}, rms, {where}.{warned}"


def fit_body(model: HammersteinModel, fit: Fit) -> str:
    """Markdown of what stands between the verdict and the figures."""
    parts = [
        *_statements(fit),
        "## Errors",
        *_errors(fit),
        "## Model",
        table(("", ""), _facts(model, fit)),
        "## Weights",
        table(
            ("pair", "operators", "gain [um/V]", "slopes [um/V]", "largest standard error [um/V]"),
            _pairs(model, fit),
        ),
        *_thresholds(model, fit),
        *(["## Dynamics", *_dynamics(model, fit)] if fit.kind == "hammerstein" else []),
    ]
    return "\n\n".join(parts)


def _statements(fit: Fit) -> Iterator[str]:
    for title, statements in (
        ("What this model cannot represent", fit.flags),
        ("Not identifiable from these records", fit.not_identifiable),
        ("What was done to the records", fit.notes),
    ):
        if statements:
            yield f"## {title}"
            yield "\n".join(f"* {markdown(statement)}" for statement in statements)
    if not fit.invertible:
        yield "**This model has no inverse: a compensator cannot be built on it as it is.**"


def _errors(fit: Fit) -> Iterator[str]:
    yield (
        "Rms errors about the mean of each record, in percent of the range of the readings, and in um. "
        "The model in the file is marked."
    )
    for title, scores in (("Records held back", fit.validation), ("Fitted records", fit.fit)):
        if scores:
            yield f"### {title}"
            header = [
                "model",
                *(f"{markdown(name)} [{unit}]" for name in fit.outputs for unit in ("%", "um")),
            ]
            yield table(header, [_score(fit, kind, score) for kind, score in scores.items()])
    if fit.trials:
        yield "### All models that were tried"
        where = (
            "the records held back"
            if fit.validation
            else ("stretches of the fitted records that were left out in turn (weights fitted to the others)")
        )
        yield (
            f"Judged on {where}, mean of the outputs. Kept is the one with the fewest parameters whose error "
            "is within one standard error of the least, and within 5 % of it."
        )
        yield table(("model", "parameters", "error [%]"), map(_trial, fit.trials))


def _trial(trial: Trial) -> list[str]:
    error = f"{trial.percent:.3g}" if math.isfinite(trial.percent) else "not stable"
    return [f"**{trial.name}**" if trial.kept else trial.name, str(trial.parameters), error]


def _score(fit: Fit, kind: Kind, score: Score) -> list[str]:
    name = f"**{KIND_NAMES[kind]}**" if kind == fit.kind else KIND_NAMES[kind]
    pairs = zip(score.nrmse_percent, score.rms_um, strict=True)
    return [name, *(f"{value:.3g}" for pair in pairs for value in pair)]


def _facts(model: HammersteinModel, fit: Fit) -> Iterator[tuple[str, str]]:
    yield "kind", KIND_NAMES[fit.kind]
    yield "weights", fit.method.replace("_", " ")
    rates = ", ".join(dict.fromkeys(f"{record.rate_hz:.6g} Hz" for record in fit.records))
    longest = max(record.samples * record.sample_time_s for record in fit.records)
    yield "sampled at", f"{rates}; the longest record lasts {longest:.4g} s"
    yield "recorded", markdown(fit.voltages.statement(fit.inputs))
    plural = "s" * (fit.delay_samples != 1)
    yield "delay", f"{fit.delay_samples:g} sample{plural} of {fit.sample_time_s:.4g} s"
    if fit.sensor_bandwidth_hz is not None:
        yield "sensor bandwidth, as given", f"{fit.sensor_bandwidth_hz:.4g} Hz"
    yield "inverse", markdown(fit.invertibility)
    for record, start, offsets in zip(fit.records, fit.starts, fit.offsets_um, strict=True):
        began = BEGINNINGS[start.kind]
        if start.kind == "turned":
            turns = zip(fit.inputs, start.turn_v, record.rest_v, strict=True)
            began += ", ".join(f" {turn + rest:.4g} V on {markdown(name)}" for name, (_, turn), rest in turns)
        if start.first:
            began += f", the first {start.first} samples left out"
        zero = ", ".join(f"{value:.4g}" for value in offsets)
        yield f"record {markdown(PurePath(record.source).name)}", f"begins {began}; offset {zero} um"


def _pairs(model: HammersteinModel, fit: Fit) -> Iterator[list[str]]:
    hysteresis, gains = model.hysteresis, model.hysteresis.gain(model.amplitude_v)
    for o, (name, counts) in enumerate(zip(fit.outputs, hysteresis.operators, strict=True)):
        known, ends = hysteresis.weight_errors, np.cumsum(counts)
        errors = None if known is None else known[o]
        for k, (input_, count) in enumerate(zip(fit.inputs, counts, strict=True)):
            if not count:
                continue
            slopes = slopes_of(hysteresis, k, model.amplitude_v)[:, o]
            yield [
                f"{markdown(input_)} to {markdown(name)}",
                str(count),
                f"{gains[o, k]:.4g}",
                f"{slopes.min():.4g} to {slopes.max():.4g}",
                "not known" if errors is None else f"{errors[ends[k] - count : ends[k]].max():.2g}",
            ]


def _thresholds(model: HammersteinModel, fit: Fit) -> Iterator[str]:
    """Fitted thresholds with their standard errors."""
    block = model.hysteresis
    if not isinstance(block, PrandtlIshlinskii) or block.threshold_covariance is None:
        return
    known = block.threshold_covariance
    yield "## Thresholds"
    first, rows = 0, []
    for name, pair in zip(fit.inputs, block.pairs[0], strict=True):
        for i, r in enumerate(pair.thresholds_v, start=first):
            error = "held" if i in known.open or r == 0.0 else f"{known.errors_v[i]:.1g}"
            rows.append([markdown(name), f"{r:.4g}", error])
        first += len(pair.thresholds_v)
    yield table(("input", "threshold [V]", "standard error [V]"), rows)
    yield "Errors of thresholds and weights together, for given dynamics; 0 is an end, open places are held."


def _dynamics(model: HammersteinModel, fit: Fit) -> Iterator[str]:
    if not fit.axes:
        yield f"State-space model of order {fit.order} on the records' sample time."
        return
    rows = []
    for name, axis in zip(fit.outputs, fit.axes, strict=True):
        modes = zip(axis.axis.creep, axis.creep_gain_errors, strict=True)
        creep = ", ".join(f"{m.gain:.3g} ± {e:.1g} over {m.time_constant_s:.3g} s" for m, e in modes)
        found = (
            (axis.axis.resonance_hz, axis.resonance_error_percent),
            (axis.axis.damping_ratio, axis.damping_error_percent),
            (axis.axis.lag_s, axis.lag_error_percent),
        )
        cells = [f"{v:.5g} ± {e:.1g} %" if v is not None and e is not None else "none" for v, e in found]
        rows.append([markdown(name), *cells, creep or "none"])
    yield table(("axis", "resonance [Hz]", "damping ratio", "lag [s]", "creep (gain, time constant)"), rows)
    yield (
        "Standard errors hold for errors that are related within a sixteenth of a record: what the model "
        "misses is in them."
    )


def _pictures(figures: Sequence[str]) -> Iterator[str]:
    for name in sorted(figures):
        stem = PurePath(name).stem
        yield f"[![{stem}]({name})]({stem}.svg)"
        yield f"*{CAPTIONS.get(stem, stem)}*"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Table in Markdown."""
    lines = [" | ".join(header), " | ".join(["---"] * len(header))]
    lines += [" | ".join(row) for row in rows]
    return "\n".join(f"| {line} |" for line in lines)
