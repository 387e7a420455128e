"""Numbers of a report as compact tables for a page."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from hammerstein.escaping import Markdown
from hammerstein.experiment.report import PARTS, TOO_FEW, Condition, Report, Sensitivity, differing, number
from hammerstein.metrics import Row
from hammerstein.quantities import by_key

MOST_LINES = 250
"""Lines of all tables together; a longer sweep is thinned."""
SHOWN_FREQUENCIES = (1000, 40, 20, 10, 6)  # columns of a table: the first that fits is taken
MOST_LOOPS = 32  # more are left to rms.csv


class NumberTable(NamedTuple):
    """One table: title, header, lines, and a remark if it omits something."""

    title: str
    header: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    remark: str = ""


def number_tables(report: Report) -> list[NumberTable]:
    """Errors of the true position and of the reading, and loops, if the report has them.

    A sweep that a page cannot hold is shown at a few frequencies: its ends, those of identification, and some
    between.
    """
    for frequencies in SHOWN_FREQUENCIES:
        rows, remark = _kept_rows(report, frequencies)
        found = [table._replace(remark=remark) for table in _tables(report, rows)]
        if sum(len(table.lines) for table in found) <= MOST_LINES:
            break
    return found


def _tables(report: Report, kept: Sequence[Row]) -> Iterator[NumberTable]:
    if any(row.rms_um is not None for row in kept):
        target = "reference" if report.scenario.reference is not None else "prediction"
        errors = _path_errors if report.is_path else _transfer_errors
        seen = "position" if report.reads_truth else "sensor's reading"
        both = [(f"Error of the {seen} against the {target}", "")]
        true = (f"Error of the true position against the {target}", "_true")
        if not report.reads_truth:
            both.insert(int(report.reading_first), true)
        for title, which in both:
            yield errors(report, kept, title, which)
    loops = [row for row in kept if row.height_um is not None]
    if report.scenario.reference is None:  # several models that are compared with one run share its loop
        shared = {(row.excited_axis, row.measured_axis, Condition.of(row)): row for row in loops}
        loops = [replace(row, compensator="") for row in shared.values()]
    if 0 < len(loops) <= MOST_LOOPS:
        yield _loops(report, loops)
    if report.bands:
        yield _bands(report, [row for row in kept if row.compensator])
    if report.sensitivities:
        yield _sensitivities(report, [row for row in kept if row.compensator])


def _kept_rows(report: Report, most: int) -> tuple[list[Row], str]:
    """Rows to show, and a remark on omitted ones."""
    frequencies = sorted({row.frequency_hz for row in report.rows})
    if len(frequencies) <= most:
        return list(report.rows), ""
    kept = selected_frequencies(frequencies, report.identified_at.values(), most)
    rows = [row for row in report.rows if row.frequency_hz in kept]
    remark = Markdown("This table shows {} of {} frequencies; `rms.csv` has all.")
    return rows, remark.format(len(kept), len(frequencies))


def _lines(rows: Sequence[Row]) -> Iterable[list[Row]]:
    """Rows that stand in one line: those of one label in one run or in its runs axis by axis."""
    return by_key(rows, lambda row: (row.compensator, Condition.of(row))).values()


def _keys(rows: Sequence[Row]) -> list[str]:
    """What tells the lines of a table apart: the label, and the parts of the conditions that differ."""
    return ["label"] * any(row.compensator for row in rows) + differing(set(map(Condition.of, rows)))


def _place(rows: Sequence[Row]) -> str:
    """What all lines have in common, for the title: `` at 50 Hz, 20 um``."""
    keys = _keys(rows)
    words = Condition.of(rows[0]).only([part for part in PARTS if part not in keys]).words()
    return f" at {words}" if words else ""


def _table(
    report: Report,
    rows: Sequence[Row],
    lines: Iterable[Sequence[Row]],
    title: str,
    heads: Iterable[str],
    cells: Callable[[Sequence[Row]], Iterable[str]],
) -> NumberTable:
    """A line for each of these groups of rows: what tells it from the others, then its cells."""
    source = "compensator" if report.scenario.reference is not None else "model"
    amplitude = f"amplitude [{Condition.of(rows[0]).unit}]"
    words = {"label": source, "frequency_hz": "frequency [Hz]", "amplitude": amplitude, "trial": "trial"}
    keys, found = _keys(rows), []
    for line in lines:
        label, condition = line[0].compensator, Condition.of(line[0])
        values = [label if key == "label" else getattr(condition, key) for key in keys]
        told = (f"{v:.6g}" if isinstance(v, float | int) else v or "" for v in values)
        found.append((*told, *cells(line)))
    return NumberTable(title, (*(words[key] for key in keys), *heads), tuple(found))


def _path_errors(report: Report, rows: Sequence[Row], title: str, which: str) -> NumberTable:
    """Each axis as rms / worst; distance and radius of all axes; what the assessment asks for."""
    several = len(report.axes) > 1
    shared = {
        f"euclidean_rms{which}_um": "distance, rms",
        f"euclidean_max{which}_um": "distance, worst",
        f"radial_max{which}_um": "radius, worst",
    } | ({} if which else {m.name: m.heading for m in report.scenario.metrics() if m.heading})
    present = {n: w for n, w in shared.items() if several and getattr(rows[0], n) is not None}
    heads = (*(f"{axis}, rms / worst" for axis in report.axes), *present.values())

    def cells(line: Sequence[Row]) -> Iterator[str]:
        yield from (_rms_and_worst(row, which) for row in line)
        yield from (number(getattr(line[0], name)) for name in present)

    return _table(report, rows, _lines(rows), f"{title}{_place(rows)} [um]", heads, cells)


def _transfer_errors(report: Report, rows: Sequence[Row], title: str, which: str) -> NumberTable:
    """One column a transfer, as rms / worst."""
    transfers = list(dict.fromkeys((row.excited_axis, row.measured_axis) for row in rows))
    heads = (_transfer(report, *transfer) for transfer in transfers)

    def cells(line: Sequence[Row]) -> Iterator[str]:
        found = {(row.excited_axis, row.measured_axis): _rms_and_worst(row, which) for row in line}
        yield from (found.get(transfer, "") for transfer in transfers)

    title = f"{title}{_place(rows)}, rms / worst [um]"
    return _table(report, rows, _lines(rows), title, heads, cells)


def _loops(report: Report, rows: Sequence[Row]) -> NumberTable:
    """A line for each transfer: how high and wide its loop is, gain and phase of its first harmonic."""
    unit = "um/V" if report.scenario.drive is not None else "um/um"
    heads = ("transfer", "height [um]", "width [um]", "width [%]", f"gain [{unit}]", "phase [deg]")

    def cells(line: Sequence[Row]) -> Iterator[str]:
        (row,) = line
        yield _transfer(report, row.excited_axis, row.measured_axis)
        yield from map(number, (row.height_um, row.width_um, row.width_percent, row.gain))
        yield "" if row.phase_deg is None else f"{row.phase_deg:z.1f}"

    title = f"Loops of the sensor's reading{_place(rows)}"
    return _table(report, rows, ([row] for row in rows), title, heads, cells)


def _bands(report: Report, rows: Sequence[Row]) -> NumberTable:
    """Median and 5-95 % over the random actuators, of the true position."""
    path = report.is_path and len(report.axes) > 1
    metric, words = report.banded_metric
    bands = {b.place: b for b in report.bands if b.metric == metric}
    transfers = list(dict.fromkeys((row.excited_axis, row.measured_axis) for row in rows))
    transfers = transfers[:1] if path else transfers
    heads = ["all axes"] if path else [_transfer(report, *transfer) for transfer in transfers]

    def cells(line: Sequence[Row]) -> Iterator[str]:
        found = {(row.excited_axis, row.measured_axis): bands.get(row.place) for row in line}
        own = (found.get(transfer) for transfer in transfers)
        yield from ("" if band is None else band.words() for band in own)

    draws = 0 if report.scenario.uncertainty is None else report.scenario.uncertainty.draws
    title = (
        f"Spread over the random actuators{_place(rows)}: {words} of the true position, median (5 to 95 % of "
        f"{draws} draws, which contain at least {100.0 * share_held(draws):.0f} % of such actuators with "
        "95 % confidence) [um]"
    )
    return _table(report, rows, _lines(rows), title, heads, cells)


def _sensitivities(report: Report, rows: Sequence[Row]) -> NumberTable:
    """Total index of every parameter, of the same figure as the bands."""
    metric, words = report.banded_metric
    own = [found for found in report.sensitivities if found.metric == metric]
    parameters = list(dict.fromkeys(found.parameter for found in own))
    known = {(*found.place, found.parameter): found for found in own}
    places = {found.place for found in own}

    def cells(line: Sequence[Row]) -> Iterator[str]:
        (row,) = line
        yield _transfer(report, row.excited_axis, row.measured_axis)
        yield from (_index(known.get((*row.place, parameter))) for parameter in parameters)

    title = (
        f"Causes of the spread{_place(rows)}: share of the variance of the {words} of the true position, for "
        f"each parameter with its interactions (95 % limits); {TOO_FEW}: the parameter alone has more"
    )
    lines = ([row] for row in rows if row.place in places)
    return _table(report, rows, lines, title, ("transfer", *parameters), cells)


def _index(found: Sensitivity | None) -> str:
    if found is None:
        return ""
    if not found.is_estimated:
        return TOO_FEW
    return f"{found.total:.2f} ({found.total_low:.2f} to {found.total_high:.2f})"


def _transfer(report: Report, excited: str, measured: str) -> str:
    """``u_x to y`` of a drive in volts, ``x to y`` of a reference."""
    if excited == "all":
        return measured
    return f"{'voltage of ' if report.scenario.drive is not None else ''}{excited} to {measured}"


def _rms_and_worst(row: Row, which: str) -> str:
    return f"{number(getattr(row, f'rms{which}_um'))} / {number(getattr(row, f'max{which}_um'))}"


def selected_frequencies(frequencies: Sequence[float], marked: Iterable[float], most: int) -> list[float]:
    """At most so many of sorted frequencies: the ends, those marked, and others spread evenly between them.

    >>> selected_frequencies([10, 20, 30, 40, 50, 60, 70, 80], [50], 4)
    [10, 30, 50, 80]
    """
    kept = {frequencies[0], frequencies[-1], *(f for f in marked if f in frequencies)}
    spread = [frequencies[round(i * (len(frequencies) - 1) / (most - 1))] for i in range(most)]
    for frequency in spread:
        if len(kept) < most:
            kept.add(frequency)
    return sorted(kept)


def share_held(draws: int) -> float:
    """Part of all actuators that a 5 to 95 % band of so many draws holds at least, with 95 % confidence.

    Between the r-th and the s-th of n draws lies a part of all that is distributed as
    Beta(s - r, n - s + r + 1) (Wilks, Annals of Mathematical Statistics 12 (1941) 91-96).

    >>> round(share_held(20), 2), round(share_held(300), 2)
    (0.66, 0.86)
    """
    from scipy.special import betaincinv  # SciPy's statistics take a second to load

    between = max(1, math.floor(0.9 * (draws - 1)))
    return float(betaincinv(between, draws - between + 1, 0.05))
