"""Names of axes, as they come from files."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from hammerstein.escaping import clean


def unique(names: Sequence[str], written: Callable[[str], str] = str) -> tuple[str, ...]:
    """Unique names: the second ``Volt`` becomes ``Volt_2``.

    Parameters
    ----------
    names : in their order
    written : form of a name in a file; two names must not have the same form

    Examples
    --------
    >>> unique(["Volt", "Volt", "Volt_2"])
    ('Volt', 'Volt_3', 'Volt_2')
    >>> unique(["stage x", "stage_x"], word)
    ('stage x', 'stage_x_2')
    """
    found: list[str] = []
    for i, name in enumerate(names):
        number, chosen = 2, name
        before, behind = set(map(written, found)), set(map(written, names[i + 1 :]))
        while written(chosen) in before or (chosen != name and written(chosen) in behind):
            chosen, number = f"{name}_{number}", number + 1
        found.append(chosen)
    return tuple(found)


def word(axis: str) -> str:
    """Name of an axis within that of a column: nothing in it ends a cell or opens a comment.

    >>> word("stage X, #2")
    'stage_X_2'
    """
    return "_".join(clean(axis).replace("#", " ").replace(",", " ").split())


def column(quantity: str, axis: str, unit: str) -> str:
    """Name of the column of an axis in a file of ours.

    >>> column("drive", "x", "v"), column("position", "stage X, #2", "um")
    ('drive_x_v', 'position_stage_X_2_um')
    """
    return f"{quantity}_{word(axis)}_{unit}"
