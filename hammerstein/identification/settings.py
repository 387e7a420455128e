"""Settings of an identification."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from hammerstein.arrays import Array, ByValue
from hammerstein.errors import InputError, Mistake, refuse
from hammerstein.identification.operators import input_grids
from hammerstein.identification.options import (
    MOST_DEAD_ZONES,
    PLAYS,
    DynamicsKind,
    InitialStateMode,
    Partition,
    Solver,
    identifiable_kinds,
    unknown_word,
)
from hammerstein.identification.score import SensorModel
from hammerstein.quantities import DELAY_S, DELAY_SAMPLES, FREQUENCY_HZ, RIDGE, THRESHOLD_V
from hammerstein.records.record import Record

MOST_OPERATORS = 200
"""Most that are taken; the paper has 15."""
MOST_CREEP_MODES = 5
"""Most that are taken, about one a decade of time."""
MOST_STATES = 100
"""Most that are taken."""
CHOICES = {
    "partition": get_args(Partition),
    "solver": get_args(Solver),
    "dynamics": get_args(DynamicsKind),
    "start": get_args(InitialStateMode),
}


@dataclass(frozen=True, eq=False)
class Settings(ByValue):
    """Options of an identification.

    Parameters
    ----------
    operators : number of play operators: one number, one for each pair (output, input), or ``auto``: the
        fewest that minimise the cross-validation error
    thresholds_v : given thresholds [V]: one array for all pairs, or one for each pair (output, input)
    partition : placement of thresholds: uniform in ``time`` as in the paper, or in ``voltage``; ``fitted``:
        fitted to the records from a start uniform in time, and kept if they lower the error significantly;
        ``operators`` is then the upper limit, and the outputs share the thresholds of an input;
        ``auto``: as ``fitted``, from a start uniform in voltage
    solver : solver for the weights: ``closed_form``, ``least_squares``, ``nonnegative`` or ``invertible``
    ridge : penalty of the weights, for more thresholds than the records determine; 0: none, or with
        hysteresis ``asymmetric`` the largest that hardly raises the error
    dynamics : ``none``, ``lag`` (a low-pass each axis), ``second_order`` (a resonance each axis),
        ``state_space``, or ``auto``: the one of the first three, or a resonance with a low-pass, with the
        lowest error
    order : number of states of a state-space model; None: estimated
    creep_modes : slow modes of each axis; ``auto``: up to three, each if it lowers the error
    delay_samples : delay of the outputs in whole samples, without the sensor's delay; None: estimated
    sensor_bandwidth_hz : first-order bandwidth of the sensor [Hz], from its data sheet; None: unlimited
    sensor_delay_s : additional delay of the sensor [s], from its data sheet; it is not part of the model,
        which
        contains only the remaining delay
    start : initial state of each record: ``rest``, ``repeated`` (the end of the same record), or ``auto``:
        estimated
    hysteresis : kind of hysteresis: ``prandtl_ishlinskii``, or ``asymmetric`` with one-sided dead-zones
        beside the plays, ``rate_dependent`` with thresholds that grow with the rate, ``bouc_wen``, or any
        registered kind that is ``Identifiable``
    dead_zones : dead-zones of each input of an asymmetric block; None: estimated
    accept_order : whether to accept columns although an output leads its input
    error_curve : whether to compute the cross-validation error for many numbers of operators
    """

    operators: int | Sequence[Sequence[int]] | Literal["auto"] = "auto"
    thresholds_v: Array | Sequence[float] | Sequence[Sequence[Array]] | None = None
    partition: Partition = "auto"
    solver: Solver = "invertible"
    ridge: float = 0.0
    dynamics: DynamicsKind = "auto"
    order: int | None = None
    creep_modes: int | Literal["auto"] = "auto"
    delay_samples: int | None = None
    sensor_bandwidth_hz: float | None = None
    sensor_delay_s: float = 0.0
    start: InitialStateMode = "auto"
    hysteresis: str = PLAYS
    dead_zones: int | None = None
    accept_order: bool = False
    error_curve: bool = True

    def __post_init__(self) -> None:
        for name in ("operators", "creep_modes", "delay_samples"):
            if isinstance(value := getattr(self, name), np.integer | float) and float(value).is_integer():
                object.__setattr__(self, name, int(value))
        unknown = [
            Mistake(name, unknown_word(getattr(self, name), known))
            for name, known in {**CHOICES, "hysteresis": tuple(identifiable_kinds())}.items()
            if getattr(self, name) not in known
        ]
        refuse("identification", [*unknown, *self._misfits(), *self._bad_numbers()])

    def without_auto(self) -> Settings:
        """The same with fixed choices in place of ``auto``, which needs plays.

        A kind of hysteresis that is no bank of plays would be chosen by what plays make of its own effects: a
        lag for thresholds that grow with the rate.
        """
        plain: dict[str, Any] = {"operators": 15, "partition": "time", "dynamics": "none", "creep_modes": 0}
        chosen = {k: v for k, v in plain.items() if str(getattr(self, k)) == "auto"}
        if "dynamics" in chosen:
            chosen["creep_modes"] = 0  # those that are asked for stand behind the kind itself
        return replace(self, **chosen)

    def with_plays(self) -> Settings:
        """The same with plays instead of another kind of hysteresis."""
        return replace(self, hysteresis=PLAYS, dead_zones=None)

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
        if isinstance(self.operators, str) and self.operators != "auto":
            yield Mistake("operators", f"{self.operators!r} is not known; give a number or auto")
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

    def _bad_numbers(self) -> Iterator[Mistake]:
        counts = np.array([1]) if isinstance(self.operators, str) else np.ravel(self.operators)
        creep, delay, bandwidth = self.creep_modes, self.delay_samples, self.sensor_bandwidth_hz
        if counts.dtype.kind not in "iu" or not 1 <= counts.min() <= counts.max() <= MOST_OPERATORS:
            yield Mistake("operators", f"must be a whole number, 1 to {MOST_OPERATORS}")
        if self.order is not None and not 1 <= self.order <= MOST_STATES:
            yield Mistake("order", f"must be 1 to {MOST_STATES}")
        if creep != "auto" and not (_whole(creep) and 0 <= creep <= MOST_CREEP_MODES):
            yield Mistake("creep_modes", f"must be auto or a whole number, 0 to {MOST_CREEP_MODES}")
        if delay is not None and not (_whole(delay) and DELAY_SAMPLES.holds(delay)):
            yield Mistake("delay_samples", f"{DELAY_SAMPLES.words()}, a whole number")
        if bandwidth is not None and not FREQUENCY_HZ.holds(bandwidth):
            what = f"{FREQUENCY_HZ.words()}; omit it for a sensor without lag"
            yield Mistake("sensor_bandwidth_hz", what)
        if not DELAY_S.holds(self.sensor_delay_s):
            yield Mistake("sensor_delay_s", DELAY_S.words())
        if not RIDGE.holds(self.ridge):
            yield Mistake("ridge", RIDGE.words())
        if self.dead_zones is not None and not 0 <= self.dead_zones <= MOST_DEAD_ZONES:
            yield Mistake("dead_zones", f"must be 0 to {MOST_DEAD_ZONES}")
        if self.thresholds_v is not None and not _rise(self.thresholds_v):
            yield Mistake("thresholds", f"{THRESHOLD_V.words()}, each larger than the previous one")

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
    def shapes(self) -> tuple[tuple[bool, bool], ...]:
        """Shapes of an axis that are tried: (resonance, lag)."""
        if self.solver == "closed_form":
            return ()
        known: dict[str, tuple[tuple[bool, bool], ...]] = {
            "lag": ((False, True),),
            "second_order": ((True, False),),
            "auto": ((False, True), (True, False)),
        }
        return known.get(self.dynamics, ())

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


def _rise(thresholds_v: Any) -> bool:
    """Whether every array of thresholds, however they are nested, holds thresholds that rise."""
    try:
        if any(np.ndim(part) for part in thresholds_v):
            return all(map(_rise, thresholds_v))
        r = np.asarray(thresholds_v, dtype=np.float64)
    except (TypeError, ValueError):  # one number in place of an array, or a word
        return False
    return all(map(THRESHOLD_V.holds, r)) and bool((np.diff(r) > 0.0).all())


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _given(
    thresholds_v: Array | Sequence[float] | Sequence[Sequence[Array]], p: int, m: int
) -> list[list[Array]]:
    if all(np.ndim(r) == 0 for r in thresholds_v):
        return [[np.asarray(thresholds_v, dtype=np.float64)] * m for _ in range(p)]
    rows = [[np.asarray(r, dtype=np.float64) for r in row] for row in thresholds_v]  # type: ignore[union-attr]
    if len(rows) != p or any(len(row) != m for row in rows):
        raise InputError("thresholds_v", f"must be one array, or {p} rows of {m} arrays (output, input)")
    return rows


def settings_of(
    operators: str, thresholds: str | None = None, creep_modes: str = "auto", **options: Any
) -> Settings:
    """Settings from words of a command line: ``operators`` and ``creep_modes`` are numbers or ``auto``.

    ``thresholds`` are voltages with commas between them, for all pairs, in place of a partition.

    Raises InputError for what is not known or does not fit together.
    """
    if thresholds is not None:
        try:
            options["thresholds_v"] = [float(word) for word in thresholds.split(",")]
        except ValueError:
            what = f"{thresholds!r} is not a list of voltages with commas between them, such as 0,0.5,1.2"
            raise InputError("identification", [Mistake("thresholds", what)]) from None
    counts: dict[str, Any] = {}
    for name, word in (("operators", operators), ("creep_modes", creep_modes)):
        if word != "auto" and not re.fullmatch(r"-?[0-9]{1,9}", word):
            what = f"must be a whole number or auto, not {word!r}"
            raise InputError("identification", [Mistake(name, what)])
        counts[name] = "auto" if word == "auto" else int(word)
    return Settings(**counts, **options)
