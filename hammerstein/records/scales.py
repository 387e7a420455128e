"""From the columns of a file to V, um and s: units that the file names, and its own time column."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError, Mistake
from hammerstein.quantities import RATE_HZ
from hammerstein.records.checks import hidden_gaps, sample_time, time_mistakes
from hammerstein.records.readers import Columns, named_time
from hammerstein.signals.text_tables import where
from hammerstein.signals.units import BASE, Kind, unit_in

OTHER_RATE = 0.01
"""Part by which a rate may differ from the one of the file's time column."""


def factors_of(
    columns: Columns, m: int, p: int, scales: tuple[float | None, float | None]
) -> tuple[list[Mistake], Array]:
    """Factors from the file's numbers to V and um: as given, or by the units that the file names."""
    mistakes, factors = [], np.ones(m + p)
    voltage: tuple[Kind, str] = ("voltage", "input")
    displacement: tuple[Kind, str] = ("displacement", "output")
    kinds = [voltage] * m + [displacement] * p
    for k, (kind, option) in enumerate(kinds):
        unit, scale = unit_in(columns.units[k]), scales[k >= m]
        if scale is not None:
            factors[k] = scale
        elif unit is not None and unit.kind == kind:
            factors[k] = unit.factor
        elif unit is not None and unit.kind != "time":
            mistakes.append(
                Mistake(
                    where(columns.names[k]),
                    f"is in {unit.symbol}, which is no {kind}: are --inputs and --outputs swapped? If not, "
                    f"give --{option}-scale, the factor from its numbers to {BASE[kind]}",
                )
            )
    return mistakes, factors


def refuse_other_time(path: str | Path, rate_hz: float, wanted: Sequence[str]) -> None:
    """Refuse a rate that the file's own time column contradicts, and gaps that only that column shows."""
    time = named_time(path)
    if time is None or time.names[0] in wanted:
        return
    name, time_s = time.names[0], time.values[0]
    step = float(np.median(np.diff(time_s)))
    units = (1.0, 1e3, 1e6, rate_hz)  # s, ms, us, or samples that are counted
    if step > 0.0 and all(abs(step * rate_hz / unit - 1.0) > OTHER_RATE for unit in units):
        unit = unit_in(time.units[0])
        seconds = step * (unit.factor if unit and unit.kind == "time" else 1.0)
        raise InputError(
            str(path),
            f"the given rate is {rate_hz:g} Hz, but the column {name} has steps of {step:.6g}, which "
            f"is {1.0 / seconds:.6g} Hz; give --time {name} instead of --rate, or the right rate",
        )
    mistakes = hidden_gaps(name, time_s, time.rows)
    if mistakes:
        raise InputError(str(path), mistakes)


def sample_time_of(columns: Columns) -> tuple[list[Mistake], float]:
    """Mistakes of the time column, which is the last one, and the sample time."""
    name, time_s = columns.names[-1], columns.values[-1]
    if len(time_s) < 2 or not np.isfinite(time_s).all():
        return [], 1.0  # told already, as too short or as gaps
    unit = unit_in(columns.units[-1])
    if unit is not None and unit.kind == "time" and unit.factor != 1.0:
        time_s = np.round(unit.factor * time_s, 15)  # 0.05 ms in s, without the last digit's noise
    mistakes = time_mistakes(name, time_s, columns.rows)
    if mistakes:
        return mistakes, 1.0
    step = sample_time(time_s)
    if not RATE_HZ.holds(1.0 / step):
        what = f"has steps of {step:.6g} s, which is a rate of {1.0 / step:.6g} Hz; it "
        what += f"{RATE_HZ.words()}. Is its unit another than its name says?"
        return [Mistake(where(name), what)], 1.0
    return [], step
