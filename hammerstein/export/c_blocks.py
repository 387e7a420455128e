"""What a block of hysteresis or dynamics gives to a template: sizes, tables, and where it starts."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from hammerstein.arrays import Array, Indices
from hammerstein.dynamics import FeedbackBlock, LinearBlock
from hammerstein.dynamics.feedback_block import InputProducts
from hammerstein.errors import InputError
from hammerstein.escaping import C
from hammerstein.hysteresis import (
    Asymmetric,
    AsymmetricState,
    BoucWen,
    BoucWenState,
    Generalised,
    Parallel,
    ParallelState,
    PlayState,
    PrandtlIshlinskii,
    Preisach,
    PreisachState,
    RateDependent,
    RateState,
    bouc_wen_kernels,
    play_kernels,
    rate_dependent_kernels,
    shape_kernels,
)


class Size(NamedTuple):
    """A number that is known when the code is compiled."""

    name: str
    value: int
    what: str


@dataclass(frozen=True, eq=False)
class Table:
    """Constant numbers: one, or an array of any shape."""

    name: str
    values: Any
    what: str

    @property
    def shape(self) -> str:
        """Brackets behind the name."""
        return "".join(f"[{n}]" for n in np.shape(self.values))


@dataclass(frozen=True, eq=False)
class CPart:
    """Input of the templates of a part; parts add up to a law.

    sizes, tables, indices : constants of the code; indices are tables of whole numbers
    start : initial values of the members of the memory
    values : other values for the templates
    """

    sizes: tuple[Size, ...] = ()
    tables: tuple[Table, ...] = ()
    indices: tuple[Table, ...] = ()
    start: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)

    def __add__(self, other: CPart) -> CPart:
        return CPart(
            self.sizes + other.sizes,
            self.tables + other.tables,
            self.indices + other.indices,
            {**self.start, **other.start},
            {**self.values, **other.values},
        )


@singledispatch
def c_block_of(hysteresis: object, state: object) -> CPart:
    """Forward block of a kind of hysteresis, from a state on.

    A new kind registers itself here; ``hysteresis`` names its template in ``parts``. The template has the
    macros ``types``, ``memory`` (members of the memory, filled by ``start``), ``functions``, and ``call``,
    which turns ``u[M]``, relative to the working point, into ``v[ROWS]``. It may call ``least`` and ``most``.

    Raises
    ------
    InputError : there are no templates for this kind
    """
    kind = getattr(hysteresis, "kind", type(hysteresis).__name__)
    raise InputError("export", f"hysteresis of kind {kind} has no C code")


@c_block_of.register
def _(hysteresis: PrandtlIshlinskii, state: PlayState) -> CPart:
    """Stack of segments on a floor at rest, with the output at each tip; the plays while an input is busy."""
    bank, m = hysteresis.bank, hysteresis.n_inputs
    groups = -(-bank.r.shape[1] // play_kernels.GROUP)
    width = groups * play_kernels.GROUP
    padded, weight = np.zeros((m, width)), np.zeros((m, width, hysteresis.n_outputs))
    weight[:, : bank.w.shape[1]] = bank.w
    segments = bank.r.shape[1] + 2
    floor = {"end": 0, "x": 0.0, "d": 0.0, "tip": np.zeros(hysteresis.n_outputs)}
    plays = []
    for k, (n, now) in enumerate(zip(bank.n, hysteresis.plays_of(state), strict=True)):
        padded[k, :n] = now
        held: list[dict[str, Any]] = [floor | {"end": int(n)}]
        for s in range(int(state.count[k])):  # the output at each tip is that of play_kernels.load
            below, end = held[-1], int(state.end[k, s])
            x, d = float(state.x[k, s]), float(state.d[k, s])
            way, turn = x - below["x"], d - below["d"]
            tip = below["tip"] + (bank.slope[k, end] * way - turn * bank.moment[k, end])
            held.append({"end": end, "x": x, "d": d, "tip": tip})
        held += [floor] * (segments - len(held))
        window = _window(state.window[k])
        plays.append({"count": int(state.count[k]), **window, "play": padded[k], "stack": held})
    return _grid(hysteresis, segments) + CPart(
        sizes=(
            Size("GROUP", play_kernels.GROUP, "operators whose weighted outputs are summed together"),
            Size("GROUPS", groups, "of them"),
            Size("LOOK", play_kernels.LOOK, "samples between two counts of the turns"),
            Size("WINDOW", play_kernels.WINDOW, "the same in the form for frequent turns"),
            Size("TURN", play_kernels.TURN, "number of operators whose update costs as much as a turn"),
            Size("LONGEST", (play_kernels.LOOK + 1) * play_kernels.TURN, "counted samples"),
        ),
        tables=(Table("weight", weight, "Weights [um/V]: input, operator, output; padded with zeros."),),
        indices=(Table("operators", bank.n, "Operators of each input."),),
        start={"plays": plays},
        values={"hysteresis": "plays", "n_padded": width},
    )


def _window(row: Array) -> dict[str, Any]:
    """How often an input turned lately, as its memory in C counts it."""
    names = ("busy", "seen", "turns", "rested", "last", "before")
    found = {name: row[getattr(play_kernels, name.upper())] for name in names}
    return found | {name: int(found[name]) for name in names[:4]}


@c_block_of.register
def _(hysteresis: Asymmetric, state: AsymmetricState) -> CPart:
    """The plays, and a line in each zone of the dead-zones."""
    lines = hysteresis.lines
    own = CPart(
        sizes=(Size("ZONES", lines.ends.shape[1], "largest number of zones of an input"),),
        tables=(
            Table("smallest_play", hysteresis.smallest_v, "Smallest threshold of each input [V]."),
            Table("zone_end", lines.ends, "Upper end of each zone [V]: input, zone."),
            Table("zone_slope", lines.slope, "Slope of its line [um/V]: input, zone, output."),
            Table("zone_start", lines.intercept, "Value of its line at 0 V [um]: input, zone, output."),
        ),
        indices=(Table("bends", lines.n, "Dead-zones of each input."),),
        start={"smallest": state.smallest_v},
        values={"hysteresis": "asymmetric"},
    )
    return c_block_of(hysteresis.plays, state.plays) + own


@c_block_of.register
def _(hysteresis: Generalised, state: PlayState) -> CPart:
    """The plays of the values of the envelopes."""
    own = CPart(values={"hysteresis": "generalised"})
    return c_block_of(hysteresis.plays, state) + envelopes_part(hysteresis) + own


def envelopes_part(hysteresis: Generalised) -> CPart:
    """Lines of the envelopes, and their hyperbolic tangents."""
    end, begin, slope = hysteresis.lines
    return _tangents(hysteresis) + CPart(
        sizes=(Size("LINES", end.shape[1], "largest number of lines of an envelope"),),
        tables=(
            Table("line_end", end, "Upper end of each line [V]: input, line."),
            Table("line_slope", slope, "Its slope: input, line."),
            Table("line_start", begin, "Its value at 0 V [V]."),
            Table("envelope_home", hysteresis.home_v, "Value of each envelope at the working point [V]."),
            Table("envelope_zero", hysteresis.working_point_v, "Working point of each envelope [V]."),
        ),
    )


def _tangents(hysteresis: Generalised) -> CPart:
    """Tangents of the envelopes, where there are any, by doubling: there is no mathematical library."""
    sizes, steepnesses, centres = hysteresis.tangents
    if not sizes.any():
        return CPart(values={"bent": False})
    return CPart(
        sizes=(
            Size("DOUBLINGS", shape_kernels.DOUBLINGS, "of the argument of a hyperbolic tangent"),
            Size("TERMS", len(shape_kernels.SERIES), "of its series"),
            Size("HALVINGS", shape_kernels.HALVINGS, "halvings in the inverse of an envelope that bends"),
        ),
        tables=(
            Table("TANH_LIMIT", shape_kernels.LIMIT, "Argument above which a hyperbolic tangent is 1."),
            Table("TANH_SCALE", 2.0**shape_kernels.DOUBLINGS, "Divisor of its argument."),
            Table("tanh_term", shape_kernels.SERIES, "Its series, the highest power first."),
            Table("tangent_size", sizes, "Size of the tangent of each envelope [V]; 0: no tangent."),
            Table("tangent_steep", steepnesses, "Its steepness [1/V]."),
            Table("tangent_centre", centres, "Its centre [V]."),
        ),
        values={"bent": True},
    )


@c_block_of.register
def _(hysteresis: Preisach, state: PreisachState) -> CPart:
    """Staircases, and the Everett function at the levels."""
    planes, turns = hysteresis.planes, state.x.shape[1]
    stairs = [
        {"count": int(count), "last": last, "x": x, "tip": tip}
        for count, last, x, tip in zip(state.count, state.last, state.x, state.tip, strict=True)
    ]
    return CPart(
        sizes=(
            Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),
            Size("TURNS", turns, "largest number of turns in the memory of an input"),
        ),
        tables=(
            Table("FARTHEST_CORNER", np.inf, "Area that marks an unused corner of the staircase."),
            Table("plane_rest", planes.rest, "Working point of each input [V]."),
            Table("plane_low", planes.low, "Lower end of each plane [V]."),
            Table("plane_high", planes.high, "Upper end of each plane [V]."),
            Table("cell_size", planes.size, "Width of a cell of each plane [V]."),
            Table("everett", planes.node, "Everett function at the levels [um]: input, high, low, output."),
            Table("beyond", planes.beyond, "Slopes below and above the planes [um/V]: input, side, output."),
        ),
        indices=(Table("cells", planes.cells, "Cells on a side of each plane."),),
        start={"stairs": stairs},
        values={"turns": turns, "hysteresis": "preisach"},
    )


@c_block_of.register
def _(hysteresis: RateDependent, state: RateState) -> CPart:
    """Every play by itself, for its threshold moves from sample to sample."""
    bank = hysteresis.bank
    return _flattening(bank.lam) + CPart(
        sizes=(
            Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),
            Size("N", bank.r.shape[1], "largest number of plays of an input"),
        ),
        tables=(
            Table("PERIOD", hysteresis.grid_s, "Sample time [s]."),
            Table("pole", hysteresis.poles, "Pole of the low-pass of each rate."),
            Table("at_rest", bank.r, "Thresholds at rest [V]: input, play."),
            Table("growth", bank.b, "Growth of a threshold in volts for each V/s [s]: input, play."),
            Table("weight", bank.w, "Weights [um/V]: input, play, output."),
        ),
        indices=(Table("operators", bank.n, "Plays of each input."),),
        start={"play": state.plays_v, "before": state.last_v, "rate": state.rate_v_per_s},
        values={"n_plays": bank.r.shape[1], "hysteresis": "rate_dependent"},
    )


def _flattening(lam: Any) -> CPart:
    """Logarithm for growth that flattens, if it does; our own code, because there is no libm."""
    if not lam.any():
        return CPart(values={"flattens": False})
    return CPart(
        sizes=(
            Size("DOUBLINGS", rate_dependent_kernels.DOUBLINGS, "that a logarithm takes out"),
            Size("TERMS", len(rate_dependent_kernels.SERIES), "of its series"),
        ),
        tables=(
            Table(
                "flattening",
                lam,
                "Rate constant at which the growth of an input flattens [s/V]; 0: linear growth.",
            ),
            Table("ROOT_TWO", rate_dependent_kernels.ROOT_TWO, "Square root of 2."),
            Table("LOG_TWO", rate_dependent_kernels.LOG_TWO, "Logarithm of 2."),
            Table("term", rate_dependent_kernels.SERIES, "Series of the logarithm, the highest power first."),
        ),
        values={"flattens": True},
    )


@c_block_of.register
def _(hysteresis: BoucWen, state: BoucWenState) -> CPart:
    """Hysteretic part of each pair, moved in steps whose number has a bound."""
    direct, hysteretic, load, unload = hysteresis.bank
    return CPart(
        sizes=(
            Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),
            Size("STEPS", bouc_wen_kernels.MOST_SUBSTEPS, "largest number of steps of one movement"),
        ),
        tables=(
            Table("LONGEST", bouc_wen_kernels.LONGEST, "Largest step, in parts of the relaxation."),
            Table("FORGOTTEN", bouc_wen_kernels.FORGOTTEN, "Movement after which z is at its limit."),
            Table("direct", direct, "Slope when z is at its limit [um/V]: output, input."),
            Table("hysteretic", hysteretic, "Gain of z [um/V]: output, input."),
            Table("load", load, "Rate at which z relaxes while it grows [1/V]: output, input."),
            Table("unload", unload, "The same while it falls [1/V]: output, input."),
        ),
        start={"lag": state.z_v.T, "here": state.last_v},
        values={"hysteresis": "bouc_wen"},
    )


_WORD = re.compile(r"/\*.*?\*/|[A-Za-z_]\w*", re.S)  # a comment is one
_FUNCTION = re.compile(r"^static \w+ (\w+)\(", re.M)
_TYPE = re.compile(r"^\} (\w+);", re.M)


@dataclass(frozen=True, eq=False)
class Beside:
    """A block of several in one law: its template, with an ending on each of its names.

    part : as for a single block; ending : of its names; what : where it stands, in a sentence
    names : those that it has in common with the others, or that are called otherwise there
    """

    part: CPart
    ending: str
    what: str
    names: Mapping[str, str]

    def named(self) -> CPart:
        """Sizes, tables and start under their new names; what the templates ask for stays with the part."""
        part = self.part

        def renamed(one: Table) -> Table:
            return Table(self._of(one.name), one.values, f"{self.what}. {one.what}")

        return CPart(
            sizes=tuple(s._replace(name=self._of(s.name)) for s in part.sizes if s.name not in self.names),
            tables=tuple(map(renamed, part.tables)),
            indices=tuple(map(renamed, part.indices)),
            start={self._of(name): value for name, value in part.start.items()},
        )

    def text(self, macro: str, environment: Any, context: dict[str, Any]) -> C:
        """What a macro of its template gives."""
        template = environment.get_template(f"parts/{self.part.values['hysteresis']}.jinja")
        module = template.make_module({**context, **self.part.values})
        functions = _FUNCTION.findall(str(module.functions()))
        own = {*functions, *_TYPE.findall(str(module.types())), *self.part.start, *self.names}
        own |= {one.name for group in (self.part.sizes, self.part.tables, self.part.indices) for one in group}
        given = str(getattr(module, macro)())
        return C(_WORD.sub(lambda word: self._of(word[0]) if word[0] in own else word[0], given))

    def _of(self, name: str) -> str:
        return self.names.get(name, f"{name}_{self.ending}")


@c_block_of.register
def _(hysteresis: Parallel, state: ParallelState) -> CPart:
    """Every part by itself, and their sum."""
    both = zip(hysteresis.parts, state.parts, strict=True)
    each = [(str(n), c_block_of(part, own)) for n, (part, own) in enumerate(both, start=1)]
    parts = [Beside(part, n, f"Part {n}", {"ROWS": "ROWS"}) for n, part in each]
    whole = CPart(
        sizes=(Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),),
        values={"hysteresis": "parallel", "parts": parts},
    )
    return sum((one.named() for one in parts), whole)


@singledispatch
def c_moving_block_of(hysteresis: Any, state: Any) -> CPart:
    """The same block inside a law that decides each sample from the one before.

    That is ``c_block_of``, where a kind has no other form for it.
    """
    return c_block_of(hysteresis, state)


@c_moving_block_of.register
def _(hysteresis: PrandtlIshlinskii, state: PlayState) -> CPart:
    """Stack of segments, with the contribution of the segments below each."""
    rows, stack = hysteresis.bank.r.shape[1] + 1, (state.end, state.x, state.d, state.below)
    each = enumerate(state.count.tolist())
    plays = [{"count": count, "stack": stacked(*(part[k, :rows] for part in stack))} for k, count in each]
    return _grid(hysteresis, rows) + CPart(start={"plays": plays}, values={"hysteresis": "moves"})


def stacked(*columns: Array | Indices) -> list[dict[str, Any]]:
    """Segments of a stack: where each ends, x, d and what lies below it."""
    return [
        {"end": int(end), "x": x, "d": d, "below": below} for end, x, d, below in zip(*columns, strict=True)
    ]


def _grid(hysteresis: PrandtlIshlinskii, segments: int) -> CPart:
    """Thresholds and partial sums of the weights."""
    bank = hysteresis.bank
    return CPart(
        sizes=(
            Size("ROWS", hysteresis.n_outputs, "outputs of the hysteresis"),
            Size("N", bank.r.shape[1], "largest number of operators of an input"),
            Size("SEGMENTS", segments, "largest number of segments of an input"),
        ),
        tables=(
            Table("threshold", bank.r, "Thresholds [V]: input, operator; padded with infinite ones."),
            Table("slope", bank.slope, "Summed weights of the first j operators [um/V]: input, j, output."),
            Table("moment", bank.moment, "The same sums of weight times threshold [um]: input, j, output."),
        ),
        values={"segments": segments, "n_rows": hysteresis.n_outputs},
    )


def dynamics_part(block: LinearBlock | FeedbackBlock) -> CPart:
    """Dynamics from rest: a linear block by its non-zero entries, or hysteresis in their loop."""
    if isinstance(block, FeedbackBlock):
        return _loop_part(block)
    n = len(block.A)
    start, column, value = block.entries
    row = np.repeat(np.arange(len(start) - 1), np.diff(start))
    return CPart(
        sizes=(
            Size("STATES", n, "of the linear block"),
            Size("ENTRIES", len(value), "nonzero entries of its matrix"),
        ),
        tables=(Table("entry", value, "Entries of the linear block [[A, B], [C, D]]."),),
        indices=(Table("row", row, "Row of each entry."), Table("column", column, "Column of each entry.")),
        start={"x": np.zeros(n)} if n else {},
        values={"n_states": n, "dynamics": "linear"},
    )


def _loop_part(block: FeedbackBlock) -> CPart:
    """Hysteresis in the loop; the order of all sums is that of the compiled loop."""
    gamma, n = block.hysteresis, len(block.A)
    start, column, value = block.entries
    if not len(value):  # C has no empty tables
        column, value = np.zeros(1, dtype=np.int64), np.zeros(1)
    fours = np.diff(start) // 4
    around = CPart(
        sizes=(
            Size("STATES", n, "of the block around the loop"),
            Size("LOOPS", gamma.n_inputs, "inputs of the hysteresis in the loop"),
            Size("LOOP_OUTPUTS", gamma.n_outputs, "of that hysteresis"),
            Size("PUSHES", len(block.push), "inputs and outputs of the hysteresis, which move the states"),
            Size("LOOP_WIDTH", n + block.n_inputs + block.moves * gamma.n_outputs, "of x, v and w together"),
            Size("REST", 3, "largest number of entries of a row outside groups of four"),
            Size("MOST_FOURS", int(fours.max(initial=0)), "most groups of four entries in a row"),
        ),
        tables=(
            Table("entry", value, "Nonzero entries of [[F, G, H], [A, 0, 0], [C, D, 0]]."),
            Table("push", block.push, "[B, E]: column, state."),
        ),
        indices=(
            Table("row_start", start, "First entry of each row."),
            Table("row_fours", fours, "Number of groups of four in it."),
            Table("column", column, "Columns of the entries."),
        ),
        start={"x": np.zeros(n)},
        values={"n_states": n, "n_moves": block.moves, "dynamics": "loop"},
    )
    return around + _products(block.products) + _inside(block)


def _inside(block: FeedbackBlock) -> CPart:
    """Plays one by one, or the block of any other kind by the names of the loop."""
    gamma = block.hysteresis
    if not isinstance(gamma, PrandtlIshlinskii):
        sizes = {"n_inputs": gamma.n_inputs, "n_outputs": gamma.n_outputs}
        part = c_block_of(gamma, gamma.rest()) + CPart(values=sizes)
        inside = Beside(part, "inside", "In the loop", {"M": "LOOPS", "ROWS": "LOOP_OUTPUTS"})
        return inside.named() + CPart(values={"inside": inside})
    bank = gamma.bank
    loops, plays, _ = bank.w.shape
    return CPart(
        sizes=(Size("LOOP_PLAYS", plays, "largest number of plays of each of them"),),
        tables=(
            Table("loop_threshold", bank.r, "Thresholds in the loop: input, play; padded with infinity."),
            Table("loop_weight", bank.w, "Their weights: input, play, output."),
        ),
        indices=(
            Table("touched_first", block.touched[:, 0], "First output that an input of the loop moves."),
            Table("touched_stop", block.touched[:, 1], "Index after the last one."),
        ),
        start={"loop_play": np.zeros((loops, plays))},
        values={"n_loops": loops, "n_loop_plays": plays, "inside": None},
    )


def _products(products: InputProducts) -> CPart:
    """Products of inputs of the loops; nothing where there are none."""
    count = len(products.factors)
    if not count:
        return CPart(values={"n_products": 0})
    return CPart(
        sizes=(Size("PRODUCTS", count, "of inputs of the loops"),),
        tables=(
            Table("loop_limit", products.limit, "Limit of an input of the loop in products."),
            Table("product_weight", products.weights, "Weights of each product: output, product."),
        ),
        indices=(Table("factor", products.factors, "Inputs of the loops that are multiplied."),),
        values={"n_products": count},
    )
