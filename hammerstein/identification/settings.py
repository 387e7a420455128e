"""Settings of an identification."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from hammerstein.arrays import Array
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.identification.options import (
    PLAYS,
    CascadeOptions,
    InitialStateMode,
    KindOptions,
    Partition,
)
from hammerstein.identification.score import SensorModel
from hammerstein.identification.static.static_block import input_grids
from hammerstein.records.record import Record


class Settings(CascadeOptions, KindOptions):
    """Options of an identification: those of ``CascadeOptions`` and ``KindOptions``.

    operators : ``auto``: the fewest that minimise the cross-validation error; otherwise one number, or one
        for each pair (output, input)
    thresholds_v : one array for all pairs, or one for each pair (output, input) [V]
    partition : ``time`` as in the paper; ``fitted`` begins uniform in time and is kept if it lowers the error
        significantly, ``auto`` begins uniform in voltage; the outputs share the fitted thresholds of an input
    ridge : for more thresholds than the records determine; with hysteresis ``asymmetric`` 0 is the largest
        that hardly raises the error
    dynamics : ``auto``: the one of ``none``, ``lag``, ``second_order``, or a resonance with a low-pass, with
        the lowest error
    hysteresis : any registered kind that is ``Identifiable``
    error_curve : whether to compute the cross-validation error for many numbers of operators

    Raises InputError for what is not known or does not fit together.
    """

    error_curve: bool = True

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        refuse("Settings", list(self._misfits()))
        return self

    def without_auto(self) -> Settings:
        """The same with fixed choices in place of ``auto``, which needs plays.

        A kind of hysteresis that is no bank of plays would be chosen by what plays make of its own effects: a
        lag for thresholds that grow with the rate.
        """
        plain: dict[str, Any] = {"operators": 15, "partition": "time", "dynamics": "none", "creep_modes": 0}
        chosen = {k: v for k, v in plain.items() if str(getattr(self, k)) == "auto"}
        if "dynamics" in chosen:
            chosen["creep_modes"] = 0  # those that are asked for stand behind the kind itself
        return self.changed(**chosen)

    def with_plays(self) -> Settings:
        """The same with plays instead of another kind of hysteresis."""
        return self.changed(hysteresis=PLAYS, dead_zones=None)

    def _misfits(self) -> Iterator[Mistake]:
        """What does not go together."""
        if self.dynamics == "state_space":
            why = (
                "cannot be separated from dynamics state_space; choose other dynamics, or let its "
                "states include it"
            )
            told = {"sensor_bandwidth_hz": self.sensor_bandwidth_hz, "sensor_delay_s": self.sensor_delay_s}
            yield from (Mistake(name, why) for name, value in told.items() if value)
        elif self.order is not None:
            yield Mistake("order", "belongs to dynamics state_space")
        if self.creep_modes not in (0, "auto") and self.dynamics in ("none", "state_space"):
            yield Mistake("creep_modes", "belongs to dynamics lag, second_order or auto")
        if self.solver == "closed_form" and self.dynamics not in ("none", "auto"):
            what = "closed_form ignores dynamics; use least_squares or invertible with them"
            yield Mistake("solver", what)
        if self.solver == "closed_form" and self.ridge > 0.0:
            yield Mistake("ridge", "belongs to the least-squares solvers, not to closed_form")
        if self.partition == "fitted":
            yield from self._misfits_of_fitted()
        if self.dead_zones is not None and self.hysteresis != "asymmetric":
            yield Mistake("dead_zones", "belongs to hysteresis asymmetric")
        if self.hysteresis != PLAYS:
            asked = {
                "dynamics": self.dynamics == "state_space",
                "solver": self.solver in ("closed_form", "nonnegative"),
            }
            why = f"cannot be used with hysteresis {self.hysteresis}"
            yield from (Mistake(name, f"{getattr(self, name)} {why}") for name in asked if asked[name])

    def _misfits_of_fitted(self) -> Iterator[Mistake]:
        """What does not go together with fitted thresholds."""
        instead = "with partition fitted; choose time or voltage"
        if self.dynamics == "state_space":
            yield Mistake("dynamics", f"state_space cannot be used {instead}")
        if self.solver == "closed_form":
            yield Mistake("solver", f"closed_form cannot be used {instead}")
        if self.thresholds_v is not None:
            yield Mistake("thresholds_v", f"cannot be given {instead}")
        if not isinstance(self.operators, int | str):
            what = "must be one number with partition fitted: the outputs share thresholds"
            yield Mistake("operators", what)

    @property
    def sensor(self) -> SensorModel:
        """Known properties of the sensor."""
        return SensorModel(self.sensor_bandwidth_hz, self.sensor_delay_s)

    @property
    def fits_thresholds(self) -> bool:
        """Whether the thresholds are fitted to the records."""
        if self.partition == "fitted":
            return True
        free = self.thresholds_v is None and isinstance(self.operators, int | str)
        return self.partition == "auto" and free and self.solver != "closed_form" and self.uses_axes

    @property
    def begun_with(self) -> Partition:
        """Partition that the thresholds have before they are fitted: the paper's for its closed form."""
        if self.partition != "auto":
            return self.partition
        return "time" if self.solver == "closed_form" else "voltage"

    @property
    def uses_axes(self) -> bool:
        """Whether the linear block, if any, acts on each output alone."""
        return self.dynamics != "state_space"

    @property
    def start_mode(self) -> InitialStateMode:
        """Mode of the initial states; with a state space, ``auto`` cannot detect a start from rest."""
        return "repeated" if self.dynamics == "state_space" and self.start == "auto" else self.start

    @property
    def fast(self) -> tuple[str, ...]:
        """What an axis may have beside creep: a ``lag``, a ``resonance``."""
        known = {"lag": ("lag",), "second_order": ("resonance",), "auto": ("lag", "resonance")}
        return () if self.solver == "closed_form" else known.get(self.dynamics, ())

    def thresholds(self, records: Sequence[Record], operators: int | None = None) -> list[list[Array]]:
        """Thresholds (output, input) of every pair for given records.

        Parameters
        ----------
        records : voltages and displacements
        operators : what ``auto`` has come to

        Raises
        ------
        InputError : numbers or thresholds for other pairs than the records have
        """
        p, m = len(records[0].y_um), len(records[0].u_v)
        if self.thresholds_v is not None:
            return _given(self.thresholds_v, p, m)
        chosen = operators if self.operators == "auto" else self.operators
        counts = np.full((p, m), chosen) if isinstance(chosen, int) else np.asarray(chosen)
        if counts.shape != (p, m):
            raise InputError("operators", f"have shape {counts.shape}; give one number, or ({p}, {m})")
        grids = {n: input_grids(records, n, self.begun_with) for n in np.unique(counts).tolist()}
        rows = [[grids[n][k].copy() for k, n in enumerate(row)] for row in counts.tolist()]
        if self.dynamics == "state_space":
            for r in (r for row in rows for r in row if r.size):
                r[0] = 0.0  # so that the static block can be a mere gain in front of the linear one
        return rows


def _given(thresholds_v: Sequence[Any], p: int, m: int) -> list[list[Array]]:
    if all(np.ndim(r) == 0 for r in thresholds_v):
        return [[np.asarray(thresholds_v, dtype=np.float64)] * m for _ in range(p)]
    rows = [[np.asarray(r, dtype=np.float64) for r in row] for row in thresholds_v]
    if len(rows) != p or any(len(row) != m for row in rows):
        raise InputError("thresholds_v", f"must be one array, or {p} rows of {m} arrays (output, input)")
    return rows
