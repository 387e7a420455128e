"""Paths and drives in files: samples on the drive's grid, their cost, and the text of a drive file."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hammerstein.arrays import Array
from hammerstein.errors import InputError, SimulationError
from hammerstein.escaping import clean
from hammerstein.model import HammersteinModel
from hammerstein.quantities import column, duration, interval, size
from hammerstein.runtime.resources import free_bytes
from hammerstein.signals.signal_files import chosen, holds, read_signal
from hammerstein.signals.units import displacement_factor, unit_in

LEAST_SHARE, MOST_SHARE = 0.01, 10.0
"""Parts of the model's travel between which a path without a unit is taken to be in um."""

OWN = ("drive_", "predicted_")  # columns of a drive file, whose reference may be a path
GAP, GAPS = 1.5, 0.01
"""Steps of time in medians of a path from which they are gaps, and the part of the steps that may be."""


def half_span_v(model: HammersteinModel) -> Array:
    """Half of the range of each input in the records (m,) [V]; not finite without limit."""
    return np.asarray(0.5 * (np.array(model.recorded.highest_v) - np.array(model.recorded.lowest_v)))


def in_um(
    path: Path, names: Sequence[str], values: Array, model: HammersteinModel, units: str | None
) -> Array:
    """Positions (p, N) of a file in um; ``units`` (default: um) holds for columns that name no unit.

    Parameters
    ----------
    path : file, for messages
    names : columns (p,) of the outputs
    values : (p, N), in um where the column names a unit
    units : nm, um, mm and so on

    Raises
    ------
    InputError : an unknown unit, one for columns that name theirs, or none although the path in um would be
        smaller than a hundredth of the travel of the model or more than ten times as large
    """
    bare = [o for o, name in enumerate(names) if unit_in(name) is None]
    if units is not None:
        factor = displacement_factor(units)
        if not bare:
            raise InputError("--units", f"the columns of {path} already name their units: {', '.join(names)}")
        values = values.copy()
        values[bare] *= factor
    elif bare:
        _refuse_doubtful(path, [names[o] for o in bare], values[bare], model)
    return values


def _refuse_doubtful(path: Path, bare: Sequence[str], values: Array, model: HammersteinModel) -> None:
    """Raise InputError where no position that is asked for fits the travel of the model in um."""
    half, asked = half_span_v(model), float(np.abs(values).max())
    if asked == 0.0 or not np.isfinite(half).all():  # nothing limits the voltages
        return
    travel = 2.0 * float(np.abs(model.amplitude(half)).max())
    if not LEAST_SHARE <= asked / travel <= MOST_SHARE:
        raise InputError(
            str(path),
            f"{', '.join(bare)} {('has' if len(bare) == 1 else 'have')} no unit; in um the path goes "
            f"to {asked:.3g} um, but the model travels {travel:.3g} um. Name the unit: --units "
            "nm, um or mm, or in the header, such as x_nm",
        )


class PathCost(NamedTuple):
    """Memory [bytes] and time [s] of one sample of two axes, measured with a million of them."""

    bytes: float
    seconds: float


DRIVE_COST = PathCost(450.0, 15e-6)
CYCLE_COST = PathCost(1300.0, 75e-6)


class PathWork(NamedTuple):
    """Cost of a path: samples on the drive's grid, and the cost of each."""

    samples: int
    sample_time_s: float
    cost: PathCost

    @property
    def bytes(self) -> float:
        """Memory at most [bytes]."""
        return self.samples * self.cost.bytes

    @property
    def seconds(self) -> float:
        """Time [s]."""
        return self.samples * self.cost.seconds

    def statement(self) -> str:
        """State samples, memory and time."""
        return (
            f"{self.samples:,} samples of {interval(self.sample_time_s)}: about {size(self.bytes)} of memory "
            f"and {duration(self.seconds)}"
        )

    def refuse_too_large(self, path: Path | str) -> None:
        """Raise SimulationError if the free memory is too small."""
        free = free_bytes()
        if self.bytes > free:
            raise SimulationError(
                f"{path}: {self.samples:,} samples of {interval(self.sample_time_s)} need about "
                f"{size(self.bytes)} of memory, but {size(free)} are free. Cut the path into parts. "
                "If its times are not in s, name their unit in the header, such as t [ms]."
            )


def _nothing(_: Any) -> None:
    """Ignore progress."""


class Onlooker(NamedTuple):
    """Receives progress of a path: ``begin`` its cost before the work, ``tell`` the current step."""

    begin: Callable[[PathWork], None] = _nothing
    tell: Callable[[str], None] = _nothing


UNWATCHED = Onlooker()


def read_path(
    path: Path,
    model: HammersteinModel,
    sample_time_s: float,
    word: str = "reference",
    cost: PathCost = DRIVE_COST,
    onlooker: Onlooker = UNWATCHED,
    units: str | None = None,
    periodic: bool = False,
) -> tuple[Array, Array, str]:
    """Times (sample,), positions (output, sample) on the drive's grid, and notes on resampling.

    Parameters
    ----------
    path : CSV file, see ``read_signal``
    word : content of the columns, ``reference`` or ``reading``
    cost : of a sample
    onlooker : receives the cost before the grid is made
    units : of columns without unit
    periodic : whether the first row follows the last one, a step of the path later

    Raises
    ------
    InputError : the file is no such path, or its unit must be named, see ``in_um``
    SimulationError : its samples do not fit the memory
    """
    times, values, names = read_signal(path)
    columns = chosen(path, names, model.outputs, "displacement", word)
    others = [name for i, name in enumerate(names) if i not in columns]
    if word == "reference" and holds(others, model.inputs):
        what = f"looks like a record: it holds {', '.join(model.inputs)} too; keep its times and positions"
        raise InputError(str(path), what)
    values = in_um(path, [names[i] for i in columns], values[columns], model, units)
    if periodic:
        times, values = np.append(times, 2.0 * times[-1] - times[-2]), np.hstack([values, values[:, :1]])
    samples = math.floor((times[-1] - times[0]) / sample_time_s + 1e-6) + (not periodic)
    if samples < 2:
        raise InputError(str(path), f"is shorter than two samples of {interval(sample_time_s)}")
    work = PathWork(samples, sample_time_s, cost)
    work.refuse_too_large(path)
    onlooker.begin(work)
    grid = times[0] + np.arange(samples) * sample_time_s
    same = samples + periodic == len(times)
    same = same and bool(np.abs(times[:samples] - grid).max() < 1e-3 * sample_time_s)
    reference = values[:, :samples] if same else _between(times, values, grid, periodic)
    unused = ", ".join(name for name in others if word == "reference" and not name.startswith(OWN))
    said = [f"Columns of the path that are no output of the model are not used: {unused}."] if unused else []
    said += [] if same else [_resampled(times, sample_time_s)]
    return grid, np.ascontiguousarray(reference), " ".join(said)


def _gaps(times: Array) -> NDArray[np.intp]:
    """Numbers of the steps that are gaps: few, and much longer than the others."""
    steps = np.diff(times)
    gaps = np.flatnonzero(steps > GAP * np.median(steps))
    return gaps if gaps.size <= GAPS * steps.size else gaps[:0]


def _between(times: Array, values: Array, grid: Array, periodic: bool) -> Array:
    """Values (row, sample) on another grid: smooth between rows, straight across gaps.

    Straight lines would give a smooth path corners, after which the inverse of a resonance rings. Modified
    Akima interpolation (``scipy.interpolate.Akima1DInterpolator``) neither has corners nor overshoots a hold.
    A period goes on from its last row to its first.
    """
    from scipy.interpolate import Akima1DInterpolator

    if _gaps(times).size:
        return np.stack([np.interp(grid, times, row) for row in values])
    if periodic:
        period_s, once = times[-1] - times[0], values[:, :-1]
        times = np.concatenate([times[:-1] + n * period_s for n in (-1, 0, 1)])
        values = np.hstack([once, once, once])
    smooth = Akima1DInterpolator(times, values, axis=1, method="makima")
    return np.asarray(smooth(np.clip(grid, times[0], times[-1])))


def _resampled(times: Array, sample_time_s: float) -> str:
    """State from which steps a path was interpolated, or where it has gaps."""
    steps, gaps = np.diff(times), _gaps(times)
    typical = float(np.median(steps))
    if not gaps.size:
        return (
            f"The path was interpolated from steps of {interval(typical)} to the sample time of the drive, "
            f"{interval(sample_time_s)}."
        )
    worst, many = int(np.argmax(steps)), "a gap" if gaps.size == 1 else f"{gaps.size} gaps, the longest"
    return (
        f"The path has {many} of {interval(steps[worst])} after {times[worst]:.6g} s, where its steps are "
        f"{interval(typical)}. The drive follows a straight line across it: check that no rows are missing."
    )


Tell = Callable[[str], None]
Group = tuple[str, str, Sequence[str], Array]
"""Columns of a drive file: their word, unit and axes, and the signals (axis, sample)."""
ROWS_AT_ONCE = 100_000
"""Rows of text in memory at a time."""


def predicted_groups(
    model: HammersteinModel, drive_v: Array, reference_um: Array, predicted_um: Array
) -> list[Group]:
    """Columns of a drive file: voltages, path and prediction."""
    paths = (("reference", reference_um), ("predicted", predicted_um))
    return [("drive", "v", model.inputs, drive_v), *((word, "um", model.outputs, um) for word, um in paths)]


def drive_csv(
    time_s: Array,
    groups: Sequence[Group],
    statements: Sequence[str],
    tell: Tell | None = None,
) -> str:
    """Text of a CSV file; its last lines, each starting with ``#``, state when it may be sent.

    The header is the first line, as spreadsheets and ``numpy.genfromtxt(names=True)`` expect.

    Parameters
    ----------
    time_s : (sample,) times [s]
    groups : word, unit, names and rows (name, sample) of every group of columns
    statements : lines below the columns
    tell : receives the number of rows written so far

    Raises
    ------
    InputError : two columns of one name, or names that are not those of the rows: nothing is written

    Examples
    --------
    >>> import numpy as np
    >>> print(drive_csv(np.zeros(1), [("drive", "v", ["x"], np.ones((1, 1)))], ["To be sent."]), end="")
    time_s,drive_x_v
    0.0,1.0
    # To be sent.
    """
    import pandas as pd

    names = ["time_s"]
    for word, unit, axes, rows in groups:
        if len(axes) != len(rows):
            raise InputError("drive file", f"{len(rows)} {word} columns for {len(axes)} names")
        names += [column(word, axis, unit) for axis in axes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError("drive file", f"two columns would have the name {twice[0]}; rename the model's axes")
    digits = 14 - math.ceil(math.log10(max(float(np.abs(time_s).max(initial=0.0)), 1e-300)))
    columns = [np.round(time_s, min(digits, 300)), *(row for *_, rows in groups for row in rows)]
    text = []
    for first in range(0, max(len(time_s), 1), ROWS_AT_ONCE):
        part = dict(zip(names, (column[first : first + ROWS_AT_ONCE] for column in columns), strict=True))
        text.append(pd.DataFrame(part).to_csv(index=False, header=first == 0, lineterminator="\n"))
        if tell is not None:
            tell(f"writing {min(first + ROWS_AT_ONCE, len(time_s)):,} of {len(time_s):,} rows")
    return "".join([*text, *(f"# {clean(' '.join(words.split()))}\n" for words in statements)])
