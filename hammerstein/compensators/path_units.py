"""Units of paths: named in a file, given by a person, or asked for where um cannot be meant."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hammerstein.arrays import Array
from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.signals.units import displacement_factor, unit_in

LEAST_SHARE, MOST_SHARE = 0.01, 10.0
"""Parts of the model's travel between which a path without a unit is taken to be in um."""


def half_span_v(model: HammersteinModel) -> Array:
    """Half of what the records covered of each input (m,) [V]; not finite where nothing limits it."""
    return np.asarray(0.5 * (np.array(model.recorded.highest_v) - np.array(model.recorded.lowest_v)))


def travel_um(model: HammersteinModel) -> Array | None:
    """Travel of each output (p,) over the recorded voltages [um]; None where nothing limits these."""
    half = half_span_v(model)
    return 2.0 * np.abs(model.amplitude(half)).max(axis=1) if np.isfinite(half).all() else None


def in_um(
    path: Path, names: Sequence[str], values: Array, model: HammersteinModel, units: str | None
) -> Array:
    """Positions (p, N) of a file in um: those whose column names no unit have that of ``units``, else um.

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
    travel, asked = travel_um(model), float(np.abs(values).max())
    if travel is None or asked == 0.0:
        return
    share = asked / float(travel.max())
    if not LEAST_SHARE <= share <= MOST_SHARE:
        raise InputError(
            str(path),
            f"{', '.join(bare)} {('has' if len(bare) == 1 else 'have')} no unit; in um the path goes "
            f"to {asked:.3g} um, but the model travels {travel.max():.3g} um. Name the unit: --units "
            "nm, um or mm, or in the header, such as x_nm",
        )
