"""Each law as sizes, tables and a start for its template."""

from functools import singledispatch
from typing import Any

import numpy as np

from hammerstein.arrays import Array, padded
from hammerstein.blocks.driving import DriveRange
from hammerstein.compensators.base import DecoupledInverseLaw, NoCompensationLaw
from hammerstein.compensators.exact import inverse_kernel as exact_kernel, piece_kernels as pieces
from hammerstein.compensators.exact.inverse import (
    ExactInverseLaw,
    GeneralisedInverseLaw,
    PreisachInverseLaw,
    RateDependentInverseLaw,
    StaticInverse,
    Tables,
)
from hammerstein.compensators.inverse_multiplicative import InverseMultiplicativeLaw
from hammerstein.compensators.kernels import STILL_V
from hammerstein.compensators.preview.hammerstein_inverse import HammersteinInverseLaw
from hammerstein.compensators.preview.loop_inverse import LoopInverseLaw
from hammerstein.errors import InputError
from hammerstein.export.c_blocks import (
    CPart,
    Size,
    Table,
    c_block_of,
    c_moving_block_of,
    dynamics_part,
    envelopes_part,
    stacked,
)
from hammerstein.export.request import ForwardModel
from hammerstein.hysteresis.asymmetric import ZoneLines


@singledispatch
def c_law_of(law: object) -> CPart:
    """What the template of a law needs.

    Raises
    ------
    InputError : there is no template for this law
    """
    raise InputError("--law", f"{type(law).__name__} has no C code")


@c_law_of.register
def _(law: LoopInverseLaw) -> CPart:
    raise InputError(
        "--law",
        "the inverse of hysteresis in a loop iterates over a whole path and has no C code. `hammerstein "
        "compensate MODEL PATH --table csv` writes the voltages; --law model exports the actuator itself",
    )


def _range(limits: DriveRange) -> CPart:
    """Range as it is sent, and the working point from which a law counts."""
    low = Table("lowest_v", limits.low_v, "Lowest voltage of the drive [V].")
    high = Table("highest_v", limits.high_v, "Highest voltage of the drive [V].")
    return CPart(tables=(low, high)) + _working_point(limits)


def _working_point(limits: DriveRange) -> CPart:
    rest, what = limits.working_point_v, "Voltage at which the plays are at rest [V]."
    has = bool(rest.any())
    return CPart(tables=(Table("working_point", rest, what),) * has, values={"has_working_point": has})


def _origin(origin_um: Array) -> CPart:
    """Position of the model at the start, from where the reference counts."""
    if not origin_um.any():
        return CPart(values={"has_origin": False})
    what = "Position of the model at the start, where the reference is zero [um]."
    return CPart(tables=(Table("origin", origin_um, what),), values={"has_origin": True})


def _counted(limits: DriveRange) -> tuple[Table, Table]:
    low, high = limits.counted
    return (
        Table("low", low, "Lowest voltage, relative to the working point [V]."),
        Table("high", high, "Highest voltage, relative to the working point [V]."),
    )


@c_law_of.register
def _(law: NoCompensationLaw) -> CPart:
    own = CPart(
        tables=(
            Table("gain", law.gain_v_per_um, "Inverse of the low-frequency gain matrix [V/um]."),
            Table("base", law.base_v, "Voltage at the start, relative to the working point [V]."),
            *_counted(law.range),
        )
    )
    return own + _range(law.range)


@c_law_of.register
def _(law: InverseMultiplicativeLaw) -> CPart:
    start = law.rest()
    own = CPart(
        sizes=(Size("PASSES", law.iterations, "iterations of the law in a sample"),),
        tables=(
            Table("gain", law.gain_v_per_um, "Gain K [V/um]."),
            Table("POLE", law.pole, "Pole of the filter; 0: a delay of one sample."),
            *_counted(law.range),
        ),
        start={"held": start.memory_v},
        values={"begins_again": law.iterations > 1 and not law.hysteresis.wipes_out},
    )
    return c_moving_block_of(law.hysteresis, start.plays) + own + _range(law.range) + _origin(law.origin_um)


@c_law_of.register
def _(law: DecoupledInverseLaw) -> CPart:
    start = law.rest()
    own = CPart(
        tables=(
            Table("STILL", STILL_V, "Smallest step that counts as movement [V]."),
            Table("jump", law.jump_v, "Smallest thresholds: size of the drive jump at a turn [V]."),
            *_counted(law.range),
        ),
        start={"turned": start.last_v, "direction": start.direction},
    )
    return c_block_of(law.inverse, start.plays) + own + _range(law.range) + _origin(law.origin_um)


@c_law_of.register(StaticInverse)
def _(law: StaticInverse[Any]) -> CPart:
    return c_inverse_of(law, law.rest()) + _range(law.range) + _origin(law.origin_um)


@singledispatch
def c_inverse_of(law: StaticInverse[Any], start: Any) -> CPart:
    """Exact inverse of a static block, on which other laws build.

    Raises
    ------
    InputError : there is no template for the inverse of this kind of hysteresis
    """
    raise InputError("export", f"{type(law).__name__} has no C code")


@c_inverse_of.register
def _(law: ExactInverseLaw, start: Any) -> CPart:
    """The walk over the pieces: the table of ``exact.piece_kernels`` by its names."""
    m, bank, design = law.n_inputs, law.square.plays.bank, law.design_tables()
    segments = bank.r.shape[1] + 2
    held = design.here["y"][law.n_outputs :]
    slope, moment = (design.w[name][:, : segments - 1] for name in ("slope", "moment"))
    return CPart(
        sizes=(
            Size("SEGMENTS", segments, "largest number of segments of an input"),
            Size("PIECES", exact_kernel.most_pieces(design.w), "pieces after which a search is abandoned"),
        ),
        tables=(
            *_walk_tables(design),
            Table("threshold", bank.r, "Thresholds behind the smallest plays [V]: input, operator."),
            Table("slope", slope, "Summed weights of the first j operators [um/V]: input, j, row."),
            Table("moment", moment, "The same sums of weight times threshold [um]: input, j, row."),
        ),
        start={"hand": [_hand(start, k) for k in range(m)]},
        values={"inverse": "walk", "moving_zones": False, "segments": segments, "held": held.tolist()},
    ) + _zones(law.square.lines, segments)


@c_inverse_of.register
def _(law: RateDependentInverseLaw, start: Any) -> CPart:
    """The walk over the zones of each sample, which are where a play is let go or taken up."""
    events = 2 * law.hysteresis.bank.r.shape[1]
    own = CPart(
        sizes=(Size("EVENTS", events, "voltages at which a play of an input is released or engaged"),),
        values={"inverse": "rate_walk"},
    )
    return c_block_of(law.hysteresis, start.model) + _moving_zones(law, start.drive_v, events + 1) + own


@c_inverse_of.register
def _(law: PreisachInverseLaw, start: Any) -> CPart:
    """The walk over the zones of each sample, which are the pieces of the branches from its memory."""
    zones = law.design_tables().w.shape[1]
    own = CPart(
        sizes=(
            Size("SIDE", zones // 2 + 2, "largest number of steps along one side of the memory of an input"),
        ),
        start={"sent": start.drive_v},
        values={"inverse": "preisach_walk"},
    )
    return c_block_of(law.hysteresis, start.model) + _moving_zones(law, start.drive_v, zones) + own


def _moving_zones(law: StaticInverse[Any], drive_v: Array, zones: int) -> CPart:
    """The walk over zones that are others in each sample: beside one play of threshold and weight 0."""
    m, design = law.n_inputs, law.design_tables()
    hand = [
        {"count": 1, "stack": [{"end": 1, "x": u, "d": 1.0, "below": np.zeros(m)}], "wanted": u, "ramp": 1.0}
        for u in drive_v.tolist()
    ]
    return CPart(
        sizes=(
            Size("PIECES", exact_kernel.most_pieces(design.w), "pieces after which a search is abandoned"),
            Size("ZONES", zones, "largest number of zones of an input"),
            Size("DEPTHS", zones + 1, "largest number of pieces in the search of an input"),
        ),
        tables=(
            *_walk_tables(design),
            Table("threshold", np.zeros((m, 2)), "That of the one play of each input [V]."),
            Table("slope", np.zeros((m, 2, m)), "Its weight [um/V]."),
            Table("moment", np.zeros((m, 2, m)), "Its weight times threshold [um]."),
        ),
        start={"hand": hand},
        values={"moving_zones": True, "zones": True, "n_zones": zones, "segments": 1, "depths": zones + 1},
    )


@c_inverse_of.register
def _(law: GeneralisedInverseLaw, start: Any) -> CPart:
    """The walk of the plays, then the inverse of the envelopes."""
    envelopes, (low, high), within = envelopes_part(law.hysteresis), law.range.counted, law.plays.range
    ends = [one.values_v[1:-1] for one in law.hysteresis.envelopes]
    lines = next(size.value for size in envelopes.sizes if size.name == "LINES")
    values = padded(ends, lines, np.inf)
    own = CPart(
        tables=(
            Table("value_end", values, "Value of each line at its upper end [V]: input, line."),
            Table("seen_lowest", within.low_v, "Input of the plays at the lowest voltage [V]."),
            Table("seen_highest", within.high_v, "Input of the plays at the highest voltage [V]."),
            Table("drive_lowest", low, "Lowest voltage, relative to the working point [V]."),
            Table("drive_highest", high, "Highest voltage, relative to the working point [V]."),
        ),
        values={"inverse": "envelope_walk"},
    )
    return c_inverse_of(law.plays, start) + envelopes + own


def _walk_tables(design: Tables) -> tuple[Table, ...]:
    """What every walk knows of its inputs."""
    here = design.here
    return (
        Table("FARTHEST", np.inf, "End of a piece without an end."),
        Table("STILL", float(here["still"][0]), "Smallest step that counts as movement [V]."),
        Table("SINGULAR", pieces.SINGULAR, "Relative pivot at which a matrix is singular."),
        Table("POOR", pieces.POOR, "Condition number above which the result must be corrected."),
        Table("play", here["play"], "Smallest threshold of each input [V]."),
        Table("low", here["low"], "Least q that falls [V]."),
        Table("high", here["high"], "Largest q that rises [V]."),
        Table("soft", here["soft"], "Movement over which the drive jump at a turn is spread [V]."),
        Table("pull", here["gain"], "Change of each row with an input [um/V]."),
    )


def _zones(lines: ZoneLines, segments: int) -> CPart:
    """Dead-zones beside the plays, where there are any."""
    if not lines.n.any():
        return CPart(values={"zones": False, "depths": segments})
    zones = lines.ends.shape[1]
    return CPart(
        sizes=(
            Size("ZONES", zones, "largest number of zones of an input"),
            Size("DEPTHS", segments + zones, "largest number of pieces in the search of an input"),
        ),
        tables=(
            Table("zone_end", lines.ends, "Upper end of each zone [V]: input, zone."),
            Table("zone_slope", lines.slope, "Slope of its line [um/V]: input, zone, row."),
            Table("zone_start", lines.intercept, "Value of its line at 0 V [um]: input, zone, row."),
        ),
        values={"zones": True, "depths": segments + zones},
    )


def _hand(start: Any, k: int) -> dict[str, Any]:
    """Memory of one input."""
    rows = start.stack[k]
    columns = (rows[:, pieces.END], rows[:, pieces.X], rows[:, pieces.D], rows[:, pieces.BELOW :])
    count, wanted, ramp = start.hand[k, [pieces.COUNT, pieces.WANTED, pieces.RAMP]]
    return {"count": int(count), "stack": stacked(*columns), "wanted": wanted, "ramp": ramp}


@c_law_of.register
def _(law: HammersteinInverseLaw) -> CPart:
    start, inverse = law.rest(), law.linear
    n, modes, raw = len(inverse.block.A), len(inverse.A), len(law.taps) - 1
    known = inverse.reach_samples
    tables = [Table("tap", inverse.taps, "Taps of the inverse dynamics: sample ahead, output, path.")]
    if raw:
        tables.append(Table("filter", law.taps, "Taps of the reference filter."))
    if modes:
        tables += [
            Table("mode", inverse.A, "Modes of the inverse dynamics, from the past."),
            Table("mode_in", inverse.B, "Input gain of the modes."),
            Table("mode_out", inverse.C, "Output gain of the modes."),
        ]
    if n:
        tables += [
            Table("GONE", exact_kernel.GONE, "Smallest distance of the linear block that counts."),
            Table("block", law.recovery.a, "State matrix of the linear block."),
            Table("block_in", law.recovery.b, "Input gain of the linear block."),
            Table("recovery", law.recovery.gain, "Gain that returns it to its path."),
        ]
    states = {"raw": start.raw, "known": start.filtered, "modes": start.modes, "away": start.away}
    ahead = CPart(
        sizes=(
            Size("RAW", raw, "earlier references for the filter"),
            Size("KNOWN", known, "stored samples of the path besides the newest"),
            Size("TAPS", len(inverse.taps), "of the inverse dynamics"),
            Size("MODES", modes, "of the inverse dynamics"),
            Size("STATES", n, "of the linear block"),
        ),
        tables=tuple(tables),
        indices=(
            Table("lead", inverse.ahead, "Samples after which each output first responds to its input."),
        ),
        start={name: value for name, value in states.items() if value.size},
        values={"n_raw": raw, "n_known": known, "n_modes": modes, "n_states": n},
    )
    return ahead + c_inverse_of(law.exact, start.exact) + _range(law.range) + _origin(law.origin_um)


@c_law_of.register
def _(law: ForwardModel) -> CPart:
    part = c_block_of(law.model.hysteresis, law.rest().hysteresis) + dynamics_part(law.block)
    return part + _working_point(law.range)
