"""Largest size of what is read from a file, judged before it is unpacked."""

from __future__ import annotations

import math
from collections.abc import Sequence

from hammerstein.errors import InputError

MOST_NUMBERS = 50_000_000
"""As many numbers are read from one variable; a file that declares more is not opened up."""


def refuse_large(shape: Sequence[int], bytes_each: int = 8) -> None:
    """Refuse an array before it is unpacked, by the shape that its file declares.

    bytes_each : of an entry; a text counts as so many numbers as would take its place
    """
    numbers = math.prod(int(n) for n in shape) * max(1, bytes_each // 8)
    if numbers > MOST_NUMBERS:
        raise InputError(
            "file",
            f"holds {numbers / 1e6:,.0f} million numbers ({8e-9 * numbers:.3g} GB); at most "
            f"{MOST_NUMBERS // 10**6} million are read: cut it into several records, or take fewer samples",
        )
