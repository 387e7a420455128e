"""Names of axes, as they come from files."""

from __future__ import annotations

from collections.abc import Sequence

from hammerstein.escaping import clean


def unique(names: Sequence[str]) -> tuple[str, ...]:
    """Names of which none stands twice: the second ``Volt`` becomes ``Volt_2``.

    >>> unique(["Volt", "Volt", "Volt_2"])
    ('Volt', 'Volt_3', 'Volt_2')
    """
    found: list[str] = []
    for i, name in enumerate(names):
        number, chosen = 2, name
        while chosen in found or (chosen != name and chosen in names[i:]):
            chosen, number = f"{name}_{number}", number + 1
        found.append(chosen)
    return tuple(found)


def column(word: str, axis: str, unit: str) -> str:
    """Name of the column of an axis in a file of ours: nothing in it ends a cell or opens a comment.

    >>> column("drive", "x", "v"), column("position", "stage X, #2", "um")
    ('drive_x_v', 'position_stage_X_2_um')
    """
    return f"{word}_{'_'.join(clean(axis).replace('#', ' ').replace(',', ' ').split())}_{unit}"
