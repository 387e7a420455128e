"""Figures of an identification: loops, residual, error against operators, frequency response.

Behind them stands that of a comparison: the errors of each model and of its compensator.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import hammerstein.reporting.figures.style as style
from hammerstein.arrays import Array
from hammerstein.errors import IdentificationError
from hammerstein.identification.fit import KIND_NAMES, Fit, Kind
from hammerstein.identification.linear.frequency_response import FrequencyResponse, measured_response
from hammerstein.identification.static.regressors import InitialState
from hammerstein.records.loops import widest_cycle
from hammerstein.records.record import Record
from hammerstein.reporting.figures.loops import LoopRun, figure_of_columns

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from hammerstein.comparison.result import Comparison, Left
    from hammerstein.identification.score import Score


LINES = 160
"""Points of a spectrum, spread evenly over the logarithm of the frequency."""
BANDS = 120
"""Parts of a noisy trace of many samples, of each of which the lowest and highest sample are drawn."""
LEAST = 1e-12
"""Smallest value on logarithmic axes, in place of zero."""
MEASURED, SEPARATED = "measured", "measured, minus the predicted response to the other inputs"
UNFITTED = "thresholds not fitted"
COHERENT = 0.5
"""Coherence from which a gain is drawn: below, the inputs explain less than half of what the output does."""
LEAST_RATIO = 1.5
"""Of the ends of an axis of gains, below which their scatter would look like a resonance."""
BROAD_SHARE = 0.5
"""Records from this part of the longest one's length on are used for the measured response."""


def identified_figures(fit: Fit) -> dict[str, Figure]:
    """Figures of a fit by name, without those that the records do not allow.

    Parameters
    ----------
    fit : what ``identify`` has found
    """
    record, start = (fit.held[0], fit.held_starts[0]) if fit.held else (fit.records[0], fit.starts[0])
    figures = {"residual": residual_figure(fit, record, start)}
    if loops := measured_loops(fit):
        figures["loops"] = loops
    if fit.error_curve:
        figures["operators"] = operators_figure(fit)
    if not fit.is_static:
        with contextlib.suppress(IdentificationError):  # sines alone tell no response at the lines between
            figures["response"] = response_figure(fit, *_responses(fit))
    return figures


def _responses(fit: Fit) -> tuple[FrequencyResponse, FrequencyResponse]:
    """Responses estimated from the records, and in the same way from the predictions of the model.

    Only long records on one sample time are used, so that the lines are close together. The window smears
    both estimates alike.
    """
    least = BROAD_SHARE * max(record.samples for record in fit.records)
    long = [pair for pair in zip(fit.records, fit.starts, strict=True) if pair[0].samples >= least]
    alike = [pair for pair in long if pair[0].sample_time_s == long[0][0].sample_time_s]
    model = fit.candidates[fit.kind]
    said = [replace(record, y_um=model.predict(record, start)) for record, start in alike]
    return measured_response([record for record, _ in alike]), measured_response(said)


def measured_loops(fit: Fit) -> Figure | None:
    """Slowest last cycle of each input at its largest amplitude, and the prediction of the model.

    If an input only moves together with others, the predicted response to the others is subtracted from the
    measurement. The loop of one pair remains,

        y - (y_model(u) - y_model(u_k alone)),

    which differs from the model's own loop by the residual of the fit, as for an input that moves alone.

    Parameters
    ----------
    fit : what ``identify`` has found

    Returns
    -------
    None if no record has a closed cycle
    """
    runs = []
    for k in range(len(fit.inputs)):
        found = widest_cycle(fit.records, k)
        label, found = (MEASURED, found) if found else (SEPARATED, widest_cycle(fit.records, k, alone=False))
        if found is None:
            continue
        i, part = found
        record, model = fit.records[i], fit.candidates[fit.kind]
        said, measured = model.predict(record, fit.starts[i])[:, part], record.y_um[:, part]
        if label == SEPARATED:
            lone = np.where(np.arange(len(record.u_v))[:, None] == k, record.u_v, record.u_v[:, :1])
            own = model.predict(replace(record, u_v=lone, verified=True), fit.starts[i])[:, part]
            measured, said = measured - (said - own), own
        said = said + (measured - said).mean(axis=1, keepdims=True)
        sent = record.u_v[k, part] + record.rest_v[k]
        runs.append(LoopRun(label, k, sent, measured, ((KIND_NAMES[fit.kind], said),)))
    return figure_of_columns(runs, fit.inputs, fit.outputs)


def residual_figure(fit: Fit, record: Record, start: InitialState) -> Figure:
    """Residual of the chosen model over time, and of all models over frequency, one row for each output.

    The line of the chosen model is solid, the others are broken.

    Parameters
    ----------
    fit : what ``identify`` has found
    record, start : record of the residual, and its initial state
    """
    others = [kind for kind in fit.candidates if kind != "linear" or fit.kind != "hammerstein"]
    kinds: list[Kind] = [fit.kind, *(kind for kind in others if kind != fit.kind)]
    left = {kind: fit.candidates[kind].residual(record, start) for kind in kinds}
    most = style.MOST_POINTS // (2 * len(fit.outputs))
    with style.drawing(0.9 + 2.2 * len(fit.outputs)) as figure:
        panels = figure.subplots(len(fit.outputs), 2, squeeze=False)
        entries: dict[str, Artist] = {}
        for o, row in enumerate(panels):
            for number, kind in enumerate(kinds):
                kept = kind == fit.kind
                pen = style.unmarked_style(number) | {"linewidth": 1.0, "zorder": 20 - number}
                if kept:  # others may leave a hundred times as much, and would hide it
                    _draw_over_time(row[0], left[kind][o], record.sample_time_s, pen, most)
                (line,) = row[1].plot(*spectrum(left[kind][o], record.sample_time_s), **pen)
                entries[KIND_NAMES[kind] + (", chosen" if kept else "")] = line
            _, unit = style.time_axis(record.sample_time_s * record.samples)
            row[0].set(ylabel=f"error of {style.axis_label(fit.outputs[o], 'µm')}", xlabel=unit)
            row[1].set(ylabel="amplitude [µm]", xlabel="frequency [Hz]", xscale="log", yscale="log")
            row[1].grid(visible=True, which="major")
        for number, axes in enumerate(panels.flat):
            style.letter(axes, number, "all models" if number % 2 else KIND_NAMES[fit.kind])
        for axes in panels[:, 1]:
            style.plain_numbers(axes.yaxis)
            style.plain_numbers(axes.xaxis)
        style.legend_above(figure, entries, f"Prediction error on {Path(record.source).name}")
    return figure


def _draw_over_time(
    axes: Axes, error: Array, sample_time_s: float, pen: Mapping[str, Any], most: int
) -> None:
    """Residual over time; for many samples, the band that they fill."""
    factor, _ = style.time_axis(sample_time_s * len(error))
    time = np.asarray(factor * sample_time_s * np.arange(len(error)))
    if len(error) <= most:
        axes.plot(time, error, **pen)
    else:
        edges, low, high = style.extremes(time, error, BANDS)
        axes.fill_between(edges, low, high, **{name: pen[name] for name in ("color", "linewidth", "zorder")})


def spectrum(error_um: Array, sample_time_s: float) -> tuple[Array, Array]:
    """Largest amplitude [um] in each of many bands of frequency [Hz], by a Hann window.

    Examples
    --------
    >>> f, a = spectrum(3.0 * np.sin(2.0 * np.pi * 50.0 * 1e-3 * np.arange(1000)), 1e-3)
    >>> round(float(f[np.argmax(a)])), round(float(a.max()), 6)
    (50, 3.0)
    """
    window = np.hanning(len(error_um) + 1)[:-1]
    amplitude = 2.0 * np.abs(np.fft.rfft(window * error_um))[1:] / window.sum()
    frequency = np.fft.rfftfreq(len(error_um), sample_time_s)[1:]
    edges = np.geomspace(frequency[0], frequency[-1] * 1.0001, LINES)
    band = np.searchsorted(edges, frequency, side="right")
    peaks = np.array([np.flatnonzero(band == b)[np.argmax(amplitude[band == b])] for b in np.unique(band)])
    return frequency[peaks], np.maximum(amplitude[peaks], LEAST)


def operators_figure(fit: Fit) -> Figure:
    """Cross-validation error against the number of operators; the number of the model is marked.

    Parameters
    ----------
    fit : what ``identify`` has found, with its error curve
    """
    counts = [point.operators for point in fit.error_curve]
    thresholds = sum(map(max, zip(*fit.operators, strict=True)))  # parameters behind them are of the axes
    fitted = fit.covariance is not None and any(i < thresholds for i in fit.covariance.fitted)
    chosen = sorted({n for row in fit.operators for n in row})
    with style.drawing(0.4 * style.WIDTH_IN, columns=1) as figure:
        axes = figure.subplots()
        entries: dict[str, Artist] = {}
        for o, name in enumerate(fit.outputs):
            errors = [max(point.nrmse_percent[o], LEAST) for point in fit.error_curve]
            pen = style.line_style(o) | {"marker": "os^xvD+"[o % 7]}
            (entries[f"{style.column_words(name)}, cross-validation, {UNFITTED}"],) = axes.plot(
                counts, errors, **pen
            )
        for n in chosen:
            mark = axes.axvline(n, color=style.PALE, linewidth=5.0, alpha=0.4, zorder=0)
        entries["operators of this model"] = mark
        for o in range(len(fit.outputs)):
            n = int(np.median([count for count in fit.operators[o] if count] or [0]))
            (point,) = axes.plot(n, max(fit.judged[fit.kind].nrmse_percent[o], LEAST), "*", markersize=11)
            records = f"{'validation' if fit.held else 'fitted'} records"
            entries[f"this model on the {records}{', thresholds fitted' if fitted else ''}"] = point
        axes.set(xlabel="operators of each pair", ylabel="rms error [% of range]", xscale="log", yscale="log")
        for axis in (axes.xaxis, axes.yaxis):
            style.plain_numbers(axis)
        style.letter(axes, 0)
        style.legend_above(figure, entries)
    return figure


def response_figure(fit: Fit, measured: FrequencyResponse, said: FrequencyResponse) -> Figure:
    """Gain of every pair over frequency, measured and by the model, and the coherence of each output.

    Gains are not drawn where the coherence is low, because they would be scatter. The gain of the model is
    estimated in the same way, from its response to the voltages of the records.

    Parameters
    ----------
    fit : what ``identify`` has found
    measured, said : estimated responses of the records, and of the model's predictions
    """
    p, m = measured.response.shape[:2]
    with style.drawing(0.9 + 2.1 * p) as figure:
        panels = figure.subplots(p, m + 1, squeeze=False)
        entries: dict[str, Artist] = {}
        for number, ((o, k), axes) in enumerate(np.ndenumerate(panels)):
            pair = [*map(style.column_words, (*fit.inputs[k : k + 1], fit.outputs[o]))]
            style.letter(axes, number, " to ".join(pair) if k < m else "coherence")
            axes.set(xscale="log", xlabel="frequency [Hz]")
            axes.set_xlim(measured.frequency_hz[0], measured.frequency_hz[-1])
            style.plain_numbers(axes.xaxis)
            if k == m:
                _draw_spectrum(axes, measured.frequency_hz, measured.coherence[o], 0)
                axes.set_ylim(-0.05, 1.05)
                continue
            clear = measured.coherence[o] >= COHERENT
            hz, gain = measured.frequency_hz[clear], np.abs(measured.response[o, k, clear])
            entries["measured"] = _draw_spectrum(axes, hz, gain, 0)
            entries[KIND_NAMES[fit.kind]] = _draw_spectrum(axes, hz, np.abs(said.response[o, k, clear]), 1)
            axes.set(yscale="log", ylabel="gain [µm/V]")
            low, high = axes.get_ylim()
            if high < LEAST_RATIO * low:
                axes.set_ylim((low * high / LEAST_RATIO) ** 0.5, (low * high * LEAST_RATIO) ** 0.5)
            style.plain_numbers(axes.yaxis)
        style.legend_above(figure, entries)
    return figure


def _draw_spectrum(axes: Axes, frequency_hz: Array, values: Array, number: int) -> Artist:
    pen = style.line_style(number) | {"marker": "" if len(values) > LINES else "o", "linewidth": 1.2}
    every = style.sparse_markers(len(values), number, 40)
    x, y = style.thin_trace(frequency_hz, np.maximum(values, LEAST), 2 * LINES)
    (line,) = axes.plot(x, y, markevery=every, clip_on=False, **pen)  # markers at the ends stay whole
    return line


MARKERS = "osD^vPX"
NAME_LETTERS = 24
"""Most letters per line of a model's name beside a panel."""
REASON_LETTERS = 34
"""Most letters of a reason beside a row; the table has longer ones."""
LEAST_PERCENT = 1e-9
"""Percentage in place of zero on a logarithmic axis."""


def compared_figure(found: Comparison) -> Figure:
    """Draw the figures of all models side by side.

    Parameters
    ----------
    found : what ``compare`` gave
    """
    names = [entry.name for entry in found.entries]
    labels = [style.in_lines(f"{entry.name} ({entry.parameters})", NAME_LETTERS) for entry in found.entries]
    with style.drawing(1.5 + 0.34 * max(5, len(names))) as figure:
        panels = figure.subplots(1, 2)
        fitted = [entry.fitted_at for entry in found.entries]
        entries = _draw_errors(panels[0], fitted, "fitted", hollow=bool(found.validation))
        if found.validation:
            held = [entry.validation_at for entry in found.entries]
            entries |= _draw_errors(panels[0], held, "validation", hollow=False)
        _draw_left(panels[1], [entry.left for entry in found.entries])
        quantities = ("rms error [% of range]", "compensator error [%]")
        for number, (axes, label) in enumerate(zip(panels, quantities, strict=True)):
            style.letter(axes, number)
            axes.set(xscale="log", xlabel=label)
            axes.margins(x=0.12, y=0.08)
            style.plain_numbers(axes.xaxis)
            chosen = names.index(found.recommended)
            band = axes.axhspan(
                chosen - 0.45, chosen + 0.45, color=style.PALE, alpha=0.28, zorder=0, linewidth=0
            )
            axes.set_yticks(range(len(names)), labels)
            axes.set_ylim(len(names) - 0.4, -0.6)
        style.legend_above(figure, {**entries, "recommended": band})
    return figure


def _draw_errors(
    axes: Axes, scores: Sequence[Mapping[float, Score]], told: str, hollow: bool
) -> dict[str, Artist]:
    """Errors of every model at each frequency."""
    drawn: dict[str, Artist] = {}
    for number, hz in enumerate(scores[0]):
        colour, marker = style.COLOURS[number % len(style.COLOURS)], MARKERS[number % len(MARKERS)]
        values = [max(score[hz].mean_percent, LEAST_PERCENT) for score in scores]
        face = "white" if hollow else colour
        (drawn[told if len(scores[0]) == 1 else f"{told}, {hz:g} Hz"],) = axes.plot(
            values, range(len(values)), marker, color=colour, markerfacecolor=face, markersize=6.0, zorder=3
        )
    return drawn


def _draw_left(axes: Axes, left: Sequence[Left]) -> None:
    """One point a model; where there is no number, why not."""
    for place, one in enumerate(left):
        if one.percent is not None:
            axes.plot(max(one.percent, LEAST_PERCENT), place, "o", color=style.DARK, markersize=5.0, zorder=3)
            continue
        why = one.reason if len(one.reason) <= REASON_LETTERS else "no compensator"
        white = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
        across = axes.get_yaxis_transform()
        axes.text(0.03, place, style.plain(why), transform=across, va="center", color="#666666", bbox=white)
