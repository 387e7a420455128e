"""Notebook representation of a value: its short text and a picture."""

from __future__ import annotations

import base64
import html
from functools import singledispatch
from typing import TYPE_CHECKING, Any

import numpy as np

from hammerstein.experiment.report import Report
from hammerstein.identification.fit import Fit
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Response
from hammerstein.records.loops import loop_table
from hammerstein.records.record import Record
from hammerstein.reporting.figures.choice import figures_of
from hammerstein.reporting.figures.identified import measured_loops
from hammerstein.reporting.figures.loops import LoopRun, loops_figure, loops_of_records
from hammerstein.reporting.figures.path import PathRun, path_figure
from hammerstein.reporting.figures.style import plain, symbol
from hammerstein.reporting.figures.write import png_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CYCLE = 400  # samples of a settled loop
SHOWN_AMPLITUDES = (1.0, 0.5, 0.25)  # of the model's amplitude


def html_of(value: Any) -> str:
    """Text and, if available, picture of a value as self-contained HTML."""
    shown = f"<p><code>{html.escape(repr(value))}</code></p>"
    figure = picture_of(value)
    if figure is None:
        return shown
    data = base64.b64encode(png_of(figure)).decode()
    return f'{shown}<img style="max-width: 100%" alt="" src="data:image/png;base64,{data}">'


@singledispatch
def picture_of(value: Any) -> Figure | None:
    """Picture of a value; None if there is none."""
    return None


@picture_of.register(HammersteinModel)
def _(model: HammersteinModel) -> Figure | None:
    """Settled loops of the static block about the middle of its range, one input driven at a time."""
    runs, known = [], model.recorded
    sine = np.sin(2.0 * np.pi * np.arange(2 * CYCLE + 1) / CYCLE)
    for k in range(len(model.inputs)):
        for part in SHOWN_AMPLITUDES:
            u = np.repeat(np.array(known.working_point_v)[:, None], len(sine), axis=1)
            half = 0.5 * part * (known.highest_v[k] - known.lowest_v[k])
            u[k] = 0.5 * (known.highest_v[k] + known.lowest_v[k]) + half * sine
            v, _ = model.static_response(u)
            runs.append(LoopRun(f"{half:g} V", k, u[k, CYCLE:], v[:, CYCLE:]))
    inputs = [f"{symbol(name, 'voltage')} [V]" for name in model.inputs]
    outputs = [f"{symbol(name, 'reading')} [µm]" for name in model.outputs]
    return loops_figure(runs, inputs, outputs, f"{plain(model.name)}: settled loops, without dynamics")


@picture_of.register(Response)
def _(response: Response) -> Figure | None:
    """Position over time, and the reference where there is one."""
    time_s, position = response.time_s, response.position_um
    if len(time_s) < 2:
        return None
    length = float(np.ptp(time_s))
    names = response.outputs or tuple(f"y{o + 1}" for o in range(len(position)))
    run = PathRun("position", "", time_s, response.reference_um, position, length)
    return path_figure([run], names, "reference")


@picture_of.register(Record)
def _(record: Record) -> Figure | None:
    """Loops of the record, if it has any."""
    return loops_of_records([record], [loop_table(record)])


@picture_of.register(Report)
def _(report: Report) -> Figure | None:
    """The first figure that answers the scenario, if its traces are there still."""
    return next(iter(figures_of(report).values()), None) if report.traces else None


picture_of.register(Fit, measured_loops)
