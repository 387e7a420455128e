"""Drive file: a header, the numbers, and below them the conditions for sending them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hammerstein.arrays import Array
from hammerstein.blocks.axis_names import column
from hammerstein.errors import InputError
from hammerstein.escaping import clean

Tell = Callable[[str], None]
ROWS_AT_ONCE = 100_000
"""Rows of text that are in memory together."""


def drive_csv(
    time_s: Array,
    groups: Sequence[tuple[str, str, Sequence[str], Array]],
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
    tell : told how many rows are written

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
    columns = [time_s, *(row for *_, rows in groups for row in rows)]
    text = []
    for first in range(0, max(len(time_s), 1), ROWS_AT_ONCE):
        part = dict(zip(names, (column[first : first + ROWS_AT_ONCE] for column in columns), strict=True))
        text.append(pd.DataFrame(part).to_csv(index=False, header=first == 0, lineterminator="\n"))
        if tell is not None:
            tell(f"writing {min(first + ROWS_AT_ONCE, len(time_s)):,} of {len(time_s):,} rows")
    return "".join([*text, *(f"# {clean(' '.join(words.split()))}\n" for words in statements)])
