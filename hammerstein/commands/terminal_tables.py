"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hammerstein.experiment.report import Report, largest
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.quantities import by_key, duration, length, size

if TYPE_CHECKING:
    from rich.table import Table

    from hammerstein.commands.playing import Played
    from hammerstein.comparison.result import Comparison
    from hammerstein.compensators.drive_file import Compensation
    from hammerstein.experiment.plan import Plan
    from hammerstein.identification.fit import Fit
    from hammerstein.records.gains import Gain
    from hammerstein.records.loops import Loop
    from hammerstein.scenario.assessment import Judgement

PLANNED = ("scenario", "part", "", "memory", "time on one processor")
RUN = (
    "scenario",
    "compensator",
    "frequency\nHz",
    "true rms\num",
    "true max\num",
    "sensor\nmax um",
    "clipped",
)
VALIDATION = "valid-\nation"
SENTENCES = ("statement", "reason", "details")
"""Columns of judgements that a terminal has no room for."""
COMPARED = (
    *("", "model", "param-\neters", "fitted", "cross-\nvalid.", VALIDATION, "in-\nverse"),
    *("comp.\nerror", "fit\ns", "step\nns"),
)
RECOMMENDED, AS_GOOD = "*", "="
_LEFT = 3  # the first columns hold words


def _table(title: str, columns: Sequence[str], rows: Iterable[Iterable[str]] = ()) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE, title_justify="left", caption_justify="left")
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < _LEFT else "right", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def result_table(report: Report) -> Table:
    """One line for each compensator or model: the most important errors."""
    title = "Worst error of each scenario: of the true position, and of the sensor's readings"
    table = _table(title, RUN)
    for label, own in by_key(report.rows, lambda row: row.compensator).items():
        rows = [row for row in own if report.is_direct(row)] or own
        table.add_row(report.name, label or "(drive in V)", *_figures(rows))
    return table


def plan_table(plans: Mapping[str, Plan], jobs: int) -> Table:
    """One line for each part of each scenario, with memory and time, and a total."""
    table = _table("Planned runs, without cached results", PLANNED)
    for name, plan in plans.items():
        for part in plan.parts:
            table.add_row(name, part.what, "", size(part.bytes), duration(part.seconds))
    seconds = sum(plan.seconds for plan in plans.values())
    largest = max(plan.bytes for plan in plans.values())
    table.add_row("all", "the largest at a time", "", size(largest), duration(seconds))
    if jobs > 1:
        table.add_row("", f"with {jobs} jobs, at best", "", "", duration(seconds / jobs))
    return table


def _figures(rows: Sequence[Row]) -> list[str]:
    frequencies = sorted({row.frequency_hz for row in rows if row.frequency_hz})
    cells = [" ... ".join(f"{f:g}" for f in dict.fromkeys([*frequencies[:1], *frequencies[-1:]]))]
    for name in ("rms_true_um", "max_true_um", "max_um"):
        value = largest(rows, name)
        cells.append("" if value is None else f"{value:.3f}")
    cut = {replace(row, measured_axis="").place: int(row.saturated_samples or 0) for row in rows}
    return [*cells, str(sum(cut.values()))]


def actuator_table(models: Iterable[HammersteinModel]) -> Table:
    """One line per actuator: size, operators, dynamics."""
    table = _table("Packaged actuators", ("name", "inputs", "outputs", "operators", "dynamics", "range_v"))
    for model in models:
        operators = sum(sum(row) for row in model.hysteresis.operators)
        words = (model.name, ", ".join(model.inputs), ", ".join(model.outputs), str(operators))
        volts = dict.fromkeys(zip(model.recorded.lowest_v, model.recorded.highest_v, strict=True))
        table.add_row(
            *words, model.dynamics.describe(), ", ".join(f"{low:g} ... {high:g}" for low, high in volts)
        )
    return table


def judgement_table(title: str, judgements: Sequence[Judgement]) -> Table:
    """One line per judgement; sentences are left to the page, which has room for them."""
    each = [judgement.cells() for judgement in judgements]
    cells = [{name: words for name, words in row.items() if name not in SENTENCES} for row in each]
    return _table(title, list(cells[0]), (row.values() for row in cells))


def compensation_table(found: Compensation) -> Table:
    """One line for each axis: voltages, samples at the range, reference, predicted error."""
    summary = found.summary()
    names = ("axis", "drive\nV", "samples\nat limit", "path\num", "largest\nerror um")
    table = _table("Predicted response", names)
    inputs = list(found.model.inputs)
    for o, (axis, figures) in enumerate(summary["axes"].items()):
        voltage = _span(summary["inputs"][inputs[o]]["drive_v"]) if o < len(inputs) else ""
        unreached = str(summary["unreached_samples"][inputs[o]]) if o < len(inputs) else ""
        cells = [_span(figures["reference_um"]), length(figures["predicted_max_um"], 4)]
        table.add_row(axis, voltage, unreached, *cells)
    return table


def _span(ends: Sequence[float]) -> str:
    return f"{length(ends[0], 4)} ... {length(ends[1], 4)}"


def fit_table(fit: Fit) -> Table:
    """One line for each kind of model and output: errors on fitted and validation records."""
    from hammerstein.identification.fit import KIND_NAMES

    names = ("fitted\n%", "fitted\num", "valid-\nation %", "valid-\nation um")[: 4 if fit.validation else 2]
    table = _table("Rms errors, in % of the range and in um", ("model", "output", "", *names))
    for kind, score in fit.fit.items():
        scores = [score, *([fit.validation[kind]] if kind in fit.validation else [])]
        for o, output in enumerate(fit.outputs):
            cells = [f"{values[o]:.3g}" for one in scores for values in (one.nrmse_percent, one.rms_um)]
            table.add_row(KIND_NAMES[kind], output, "chosen" if kind == fit.kind else "", *cells)
    return _narrow(table, len("output"))


def comparison_table(found: Comparison) -> Table:
    """One line per model, simplest first; the recommended one is marked."""
    from hammerstein.reporting.compare_page import figures

    columns = [name for name in COMPARED if found.validation or name != VALIDATION]
    title = f"errors in % of the range; {RECOMMENDED} recommended, {AS_GOOD} as good"
    table = _table(f"Models compared: {title}", columns)
    for entry in found.entries:
        marked = AS_GOOD if entry.as_good else ""
        marked = RECOMMENDED if entry.name == found.recommended else marked
        told = {name: cell for name, cell in figures(entry).items() if name != "as good"}
        times = (f"{entry.seconds:.2g}", f"{entry.ns_a_sample:.3g}")
        table.add_row(marked, entry.name, *told.values(), *times)
    table.caption = "comp. error: compensator error; plant: the model that replaces the actuator"
    return _narrow(table)


def rates_table(found: Comparison) -> Table:
    """One line per model: its error at the frequency of each record."""
    where = "validation" if found.validation else "fitted"
    rates = [f"{hz:g} Hz" for hz in found.frequencies_hz]
    table = _table(f"Errors on records {where}, in % of their range", ("", "model", *rates))
    for entry in found.entries:
        marked = RECOMMENDED if entry.name == found.recommended else ""
        table.add_row(marked, entry.name, *(f"{at.mean_percent:.3g}" for at in entry.judged_at.values()))
    return _narrow(table)


def _narrow(table: Table, least: int = len("prandtl_ishlinskii")) -> Table:
    """Let names be broken between words on a narrow terminal, and no number."""
    table.columns[1].min_width = least
    for column in table.columns[2:]:
        column.justify, column.no_wrap = "right", True
    table.padding = (0, 0, 0, 1)
    return table


def gains_table(gains: Sequence[Gain]) -> Table:
    """One line per pair: span of the voltage, span of the output, and their ratio."""
    columns = ("input", "output", "", "span_v", "span_um", "gain_um_per_v")
    numbers = ((f"{n:.4g}" for n in (g.span_v, g.span_um, g.um_per_v)) for g in gains)
    rows = ((g.input, g.output, "", *own) for g, own in zip(gains, numbers, strict=True))
    return _table("Content of the records", columns, rows)


def loops_table(found: Mapping[str, Sequence[Loop]]) -> Table:
    """One line per loop of a measured record, in 80 columns; --json also has start and area."""
    numbers = ("swing\nV", "height\num", "width\num", "width\n%", "closure\num", "drift\num", "settled")
    alone = "" if len(found) > 1 else f" of {Path(next(iter(found))).name}"
    table = _table(f"Loops{alone}", ("" if alone else "file", "input", "output", *numbers))
    table.padding = 0
    table.columns[0].max_width = 14  # longer names are folded
    for source, loops in found.items():
        name = Path(Path(source).name.rpartition(", ")[2]).stem  # of two arrays the experiment
        for loop in loops:
            size = (2.0 * loop.amplitude_v, loop.height_um, loop.width_um, loop.width_percent)
            table.add_row(
                "" if alone else name,
                loop.input,
                loop.output + (" (minor)" if loop.minor else ""),
                *(f"{round(number, 4) + 0.0:.4g}" for number in (*size, loop.closure_um, loop.drift_um)),
                "yes" if loop.settled else "no",
            )
    return table


def facts_table(title: str, facts: Iterable[tuple[str, str]]) -> Table:
    """One line per fact: its name and its text."""
    table = _table(title, ("", ""), facts)
    table.show_header = False
    table.columns[1].min_width = len(title)  # a title is no wider than its table
    return table


def played_table(found: Played) -> Table:
    """One line for each input and output: its range."""
    table = _table("Played", ("wire", "name", "", "lowest", "highest"))
    for word, unit, spans in (("voltage", "V", "inputs"), ("position", "um", "outputs")):
        for name, (low, high) in found.summary()[spans].items():
            table.add_row(f"{word} [{unit}]", name, "", f"{low:.5g}", f"{high:.5g}")
    return table
