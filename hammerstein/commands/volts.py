"""Voltages from the words of an option."""

from __future__ import annotations


def volts(option: str, words: str | None) -> tuple[float, ...] | None:
    """Voltages from an option, with commas between them.

    Raises InputError for words that are none.

    >>> volts("--range", "0,120")
    (0.0, 120.0)
    """
    from hammerstein.errors import InputError

    if words is None:
        return None
    try:
        return tuple(float(word) for word in words.split(","))
    except ValueError:
        raise InputError(option, f"{words!r} are no voltages with commas between them") from None
