"""Fit report as a page and as JSON."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np

from hammerstein.arrays import Array
from hammerstein.escaping import Markdown, code, markdown, markdown_page
from hammerstein.hysteresis import BoucWen, PrandtlIshlinskii, slopes_of
from hammerstein.identification.fit import KIND_NAMES, Fit
from hammerstein.identification.model_selection import CLOSE
from hammerstein.identification.residual_analysis import noise_within
from hammerstein.model import HammersteinModel
from hammerstein.quantities import LEAST_SHARE, interval, percent
from hammerstein.reporting.figures.identified import identified_figures
from hammerstein.reporting.figures.write import files_of
from hammerstein.reporting.page import NumberFile, Page, Shown, figures_section, paragraphs, points
from hammerstein.runtime.staging import Owner, staged, staged_beside
from hammerstein.signals.units import spoken

FIT = Owner("fit")
MODEL = Owner("model", single=True)
ALWAYS = ("fit.json", "report.html", "report.md")
MOSTLY = 0.7
"""Noise of a record, in parts of the error, from which half of the error's power is noise."""
MOST_REMARKS = 2
"""Most limits of a model on a terminal; the report lists all."""

CAPTIONS = {
    "loops": (
        "Loops",
        "One cycle of each input: measured, and predicted by the model (dark dashes). If an input "
        "only moves together with others, the predicted response to the others is subtracted from "
        "the measurement.",
    ),
    "residual": (
        "Prediction error",
        "Over time: prediction error of the chosen model; dense samples are drawn as a band from minimum to "
        "maximum. Over frequency: largest amplitude in each band, for every kind of model.",
    ),
    "operators": (
        "Error against the number of operators",
        "Lines: cross-validation error against the number of operators, without fitted thresholds. For "
        "other kinds, the lines show plays, without automatic dynamics. The grey bar and star mark this "
        "model; the legend gives its records, and whether its thresholds are fitted.",
    ),
    "response": (
        "Gain over frequency",
        "Gain of each pair, estimated from the records and, in the same way, from the model's "
        "predictions. Coherence: the fraction of each output's power that the inputs explain linearly. "
        "Where it is below 0.5, noise, hysteresis or a sharp resonance hide the gain, which is not drawn.",
    ),
}


class Asked(NamedTuple):
    """Command line of ``identify``, so that a page can give the next command.

    model_file : file of the model; files : files of the first record; words : records and options
    """

    model_file: Path
    files: Sequence[Path]
    words: Sequence[str]


BEGINNINGS = {
    "rest": "from rest",
    "stepped": "with a step from 0 V",
    "turned": "after a drive to",
    "repeated": "in the state in which it ends",
}


def fit_json(model: HammersteinModel, fit: Fit) -> str:
    """Complete fit as one JSON object: full precision, sorted keys, equal fits give equal bytes."""
    plain = fit.as_dict() | {
        "model": model.name,
        "dynamics": model.dynamics.model_dump(mode="json"),
        "records": [PurePath(record.source).name for record in fit.records],
        "held_records": [PurePath(record.source).name for record in fit.held],
    }
    return json.dumps(plain, indent=1, sort_keys=True, allow_nan=False) + "\n"


def fit_page(
    model: HammersteinModel, fit: Fit, figures: Collection[str] = (), asked: Asked | None = None
) -> Page:
    """Page of a fit; equal fits give equal pages.

    Parameters
    ----------
    model, fit : result of ``identify``
    figures : names of its files beside the page
    asked : its command line, if there was one
    """
    shown = [Shown(name, *text) for name, text in CAPTIONS.items() if f"{name}.svg" in figures]
    return Page(
        heading=Markdown("# Fit report of {}").format(model.name),
        what="Fit report",
        title=f"How far can you trust the model {model.name}?",
        answer=paragraphs([points(summary(model, fit, asked)), markdown(fit.verdict)]),
        facts=[
            KIND_NAMES[fit.kind],
            f"records: {', '.join(PurePath(record.source).name for record in fit.records)}",
        ],
        body=paragraphs([figures_section(shown), _body(model, fit)]),
        numbers=[NumberFile("fit.json", fit_json(model, fit))],
    )


def write_fit(
    model: HammersteinModel,
    fit: Fit,
    path: Path,
    folder: Path,
    figures: bool = True,
    overwrite: bool = False,
    asked: Asked | None = None,
) -> tuple[Path, ...]:
    """Write the model file, both pages, ``fit.json`` and the figures: all of them, or none.

    Gives the places of files of an earlier fit that a person had changed and that were kept.

    Raises InputError if they cannot be written.
    """
    with ExitStack() as opened:
        stage = opened.enter_context(staged(folder, FIT, overwrite))
        together = folder.resolve() == path.parent.resolve()
        models = stage if together else opened.enter_context(staged_beside(path, MODEL, overwrite))
        drawn = dict(files_of(identified_figures(fit) if figures else {}))
        fit_page(model, fit, drawn, asked).write(stage, "report", drawn)
        models.write(path.name, model.to_json(), MODEL)
    return tuple(dict.fromkeys(stage.kept + models.kept))


def summary(model: HammersteinModel, fit: Fit, asked: Asked | None = None) -> list[Markdown]:
    """Usability of the model, three numbers, and the next command."""
    numbers = [_error(fit)]
    if "linear" in fit.judged and fit.kind != "linear":
        linear = max(fit.judged["linear"].nrmse_percent)
        numbers.append(f"Rms error of a linear gain: {at_most(linear / 100.0)} of the range.")
    resonances = [axis.axis.resonance_hz for axis in fit.axes if axis.axis.resonance_hz is not None]
    fastest = min(fit.records, key=lambda record: record.sample_time_s).rate_hz
    numbers.append(
        f"Lowest resonance: {min(resonances):.4g} Hz." if resonances else f"Sampling rate: {fastest:.6g} Hz."
    )
    said, command = next_step(model, fit, asked)
    after = Markdown("{} {}").format(said, code(command)) if command else markdown(said)
    return [Markdown("**{}**{}").format(*_usable(fit)), *map(markdown, numbers), after]


def answer(model: HammersteinModel, fit: Fit, folder: Path, asked: Asked) -> list[str]:
    """At most three lines for a terminal: use of the model and its error, first limits, next command."""
    remarks = [*fit.flags, *fit.not_identifiable, *fit.notes]
    said = [f"{''.join(_usable(fit)).replace(' (see below)', '')} {_error(fit)}"]
    if remarks:
        more = len(remarks) - MOST_REMARKS
        after = f"; {more} more in the report" if more > 0 else ""
        said.append(f"Limits: {'; '.join(remarks[:MOST_REMARKS])}{after}.")
    files = f"Model in {asked.model_file}, report in {folder / 'report.html'}."
    return [*said, " ".join((files, *next_step(model, fit, asked))).strip()]


def at_most(share: float) -> str:
    """Write an upper bound in percent.

    >>> at_most(0.0378), at_most(1e-16)
    ('at most 3.8 %', 'below 0.0001 %')
    """
    return "below 0.0001 %" if 0.0 < share < LEAST_SHARE else f"at most {percent(share)}"


def _error(fit: Fit) -> str:
    """Rms error of each output, and the largest as a share of the range."""
    score = fit.judged[fit.kind]
    pairs = zip(map(spoken, fit.outputs), score.rms_um, strict=True)
    each = ", ".join(f"{um:.3g} um on {name}" for name, um in pairs)
    worst = at_most(max(score.nrmse_percent) / 100.0)
    records = "validation records" if fit.validation else "fitted records"
    noise = noise_within(fit.held or fit.records, score.rms_um)
    if (noise > MOSTLY * np.array(score.rms_um)).any():
        told = zip(noise.tolist(), map(spoken, fit.outputs), strict=True)
        records += "; this includes their noise, " + ", ".join(f"{um:.3g} um on {name}" for um, name in told)
    return f"Rms error about the mean of each record: {each}; {worst} of the range ({records})."


def _usable(fit: Fit) -> tuple[str, str]:
    """Use of the model, and its limits."""
    if not fit.invertible:
        return "Usable for simulation only", ": the model has no inverse."
    if fit.flags:
        why = ": the records show effects that the model cannot represent (see below)."
        return "Not usable for compensation", why
    better = "; hammerstein compare may find a better model" if fit.other_kinds else ""
    untested = "." if fit.validation else "; untested on other records."
    return "Usable for simulation and compensation", better + untested


def next_step(model: HammersteinModel, fit: Fit, asked: Asked | None = None) -> tuple[str, str]:
    """Next step in words, and its command if there is one."""
    if not fit.invertible:
        if asked is None:
            return f"Next: {fit.invertibility}", ""
        return "Next, to find a model with an inverse:", _command("compare", *asked.words)
    if (fit.flags or (fit.validation and fit.other_kinds)) and asked is not None:
        return "Next:", _command("compare", *asked.words)
    if fit.validation:
        law = "exact_inverse" if fit.is_static else "hammerstein_inverse"
        law = "inverse_multiplicative" if isinstance(model.hysteresis, BoucWen) else law
        file = str(asked.model_file) if asked else f"{model.name}.json"
        return "Next:", _command("compensate", file, "path.csv", "--law", law, "--out", "drive.csv")
    if asked is None:
        return "Next: identify again, with a validation record.", ""
    files = [str(file.with_name(f"{file.stem}_validation{file.suffix}")) for file in asked.files]
    held = [word for file in files for word in ("--validate", file)]
    again = _command("identify", *asked.words, "--out", str(asked.model_file), *held)
    return f"Next: record another motion as {' and '.join(files)}, then", again


def _command(*words: str) -> str:
    return f"hammerstein {shlex.join(words)}"


def _body(model: HammersteinModel, fit: Fit) -> Markdown:
    """Markdown of the sections after the figures."""
    return markdown_page(
        "fit_body.md.jinja",
        fit=fit,
        kinds=KIND_NAMES,
        dynamics=model.dynamics.describe(),
        close=CLOSE,
        interval=interval,
        infinity=math.inf,
        rates_hz=dict.fromkeys(f"{record.rate_hz:.6g} Hz" for record in fit.records),
        longest_s=max(record.samples * record.sample_time_s for record in fit.records),
        begun=list(_begun(fit)),
        pairs=list(_pairs(model, fit)),
        thresholds=list(_thresholds(model)),
    ).strip()


def _begun(fit: Fit) -> Iterator[tuple[str, str, Sequence[float]]]:
    """Name of each record, how it begins, and the offsets of its outputs [um]."""
    creeps = any(fitted.axis.creep for fitted in fit.axes)
    for record, start, offsets in zip(fit.records, fit.starts, fit.offsets_um, strict=True):
        began = "while it still crept after a step" if start.held and creeps else BEGINNINGS[start.kind]
        if start.kind == "repeated" and (start.first or record.period_samples is not None):
            began = "in motion"
        if start.kind == "turned":
            turns = zip(fit.inputs, start.turn_v, record.rest_v, strict=True)
            began += ", ".join(
                f" {before + rest:.4g} V and then {turn + rest:.4g} V on {name}"
                for name, (before, turn), rest in turns
            )
        if start.first:
            began += f", first {start.first} samples excluded"
        yield PurePath(record.source).name, began, offsets


class _Pair(NamedTuple):
    """What one output has of one input; errors : of its weights, None where they are not known [um/V]."""

    input: str
    output: str
    operators: int
    gain: float
    slopes: Array
    errors: Array | None


def _pairs(model: HammersteinModel, fit: Fit) -> Iterator[_Pair]:
    """Every pair that has operators; none in front of a loop, whose plays are of its own signals."""
    if fit.kind == "in_loop":
        return
    hysteresis, gains = model.hysteresis, model.gain(model.amplitude_v)
    alone, joint = hysteresis.weight_errors, model.covariance
    given = alone if alone is None or joint is None else joint.weight_errors(alone)
    known: Sequence[Array | None] = given or [None] * len(fit.outputs)
    for o, (name, counts, errors) in enumerate(zip(fit.outputs, hysteresis.operators, known, strict=True)):
        stops = np.cumsum(counts)
        for k, (input_, count) in enumerate(zip(fit.inputs, counts, strict=True)):
            own = None if errors is None else errors[stops[k] - count : stops[k]]
            slopes = slopes_of(hysteresis, k, model.amplitude_v)[:, o]
            if count:
                yield _Pair(input_, name, count, float(gains[o, k]), slopes, own)


def _thresholds(model: HammersteinModel) -> Iterator[tuple[str, float, float | None]]:
    """Input, value and standard error of each fitted threshold [V]; None where it is not identifiable."""
    block, known = model.hysteresis, model.covariance
    if not isinstance(block, PrandtlIshlinskii) or known is None:
        return
    each = [(name, r) for k, name in enumerate(model.inputs) for r in block.bank.r[k, : block.bank.n[k]]]
    if not any(i < len(each) for i in known.fitted):
        return
    for i, ((name, r), error_v) in enumerate(zip(each, known.errors, strict=False)):
        yield name, r, error_v if i in known.fitted and i not in known.open else None
