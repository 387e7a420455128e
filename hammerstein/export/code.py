"""The two C files of a law, and their cost."""

import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import PurePath
from typing import Any

import numpy as np
from markupsafe import Markup
from pydantic import Field

from hammerstein.arrays import Array
from hammerstein.blocks import Law
from hammerstein.compensators import COMPENSATORS
from hammerstein.dynamics import discretise
from hammerstein.escaping import C, Markdown, templates_of
from hammerstein.export.c_blocks import Beside, CPart, Table
from hammerstein.export.c_laws import c_law_of
from hammerstein.export.literals import identifier, in_single_precision, initializer
from hammerstein.export.operations import Code, Cost
from hammerstein.export.request import MODEL, ForwardModel, Request
from hammerstein.export.trial import FLAGS, CallShape, Library, adverse
from hammerstein.model import HammersteinModel
from hammerstein.quantities import POSITION_UM, VOLTAGE_V, interval
from hammerstein.validation import Strict


class MeasuredCode(Strict):
    """Figures that stand in the code, and are kept with it.

    Without a C compiler there are none.
    """

    operations: int | None = Field(default=None, description="most operations of a step that were found")
    samples: int = Field(default=0, description="samples of the search")
    loss_rms: float | None = Field(default=None, description="of single precision, in the unit of the output")
    loss_max: float | None = None


LOWEST, HIGHEST = ("low", "lowest_v", "drive_lowest"), ("high", "highest_v", "drive_highest")
INWARDS = dict.fromkeys(LOWEST, 1.0) | dict.fromkeys(HIGHEST, -1.0)
"""Ends of the range: in single precision they are rounded to its inside."""


TARGETS: dict[str, type[Markup]] = {".md": Markdown, ".xml": Markup}
"""Languages of templates by the ends of their names; all others are in C, or hold words alone."""

LAGS, LAG_POINTS = (0.01, 0.1), 2000
"""Parts of a sine that dynamics may cost before that is told, and frequencies that are tried."""


@dataclass(frozen=True, eq=False)
class CCode:
    """A law as C.

    Parameters
    ----------
    request : options of the export
    model : the model
    block : the designed law, or the model as a block
    """

    request: Request
    model: HammersteinModel
    block: Law[Any] | ForwardModel

    @property
    def name(self) -> str:
        """Name of the law in C, and of its files."""
        return f"{identifier(self.model.name)}_{self.request.law}"

    @property
    def real(self) -> str:
        """Type in which everything is computed."""
        return "float" if self.request.float32 else "double"

    @property
    def is_model(self) -> bool:
        """Whether this is the actuator itself: volts go in, positions come out."""
        return self.request.law == MODEL

    @cached_property
    def shape(self) -> CallShape:
        """How it is called."""
        m, p = self.block.n_inputs, self.block.n_outputs
        return CallShape(self.name, self.real, *((m, p) if self.is_model else (p, m)))

    @cached_property
    def cost(self) -> Cost:
        """Bytes, and operations of a step at most."""
        return self._parsed.cost()

    @cached_property
    def _parsed(self) -> Code:
        return Code(self.name, self.header(), self.source(None))

    @property
    def model_on_grid(self) -> HammersteinModel:
        """The model on the law's sample grid, as one that knows the rate must be."""
        return self.model.on_grid(self.request.sample_time_s)

    def adverse(self, samples: int) -> Array:
        """Signal (axis, sample) in which the dearest step is looked for, see ``trial.adverse``."""
        return adverse(self.block, self.model_on_grid, samples)

    def library(
        self, counting: bool = False, command: str | None = None, flags: Sequence[str] = FLAGS
    ) -> Library:
        """Compile it here, in one file, and load it; see ``Library``."""
        plain = self.header() + self.source(None).replace(f'#include "{self.name}.h"\n', "")
        return Library(self.shape, self._parsed.counting() if counting else plain, counting, command, flags)

    def header(self) -> str:
        """Text of the header."""
        return self._rendered("law.h.jinja", None)

    def source(self, measured: MeasuredCode | None) -> str:
        """Text of the source, with the measured figures at its top."""
        return self._rendered("law.c.jinja", measured)

    def context(self) -> dict[str, Any]:
        """Names that all templates know."""
        m, p = self.block.n_inputs, self.block.n_outputs
        entering, leaving = ("drive_v", "position_um") if self.is_model else ("reference_um", "drive_v")
        return {
            "name": self.name,
            "law": self.request.law,
            "real": self.real,
            "title": self.title(),
            "entering": entering,
            "leaving": leaving,
            "reads": "Voltages [V]" if self.is_model else "A reference [um]",
            "gives": "positions [um]" if self.is_model else "voltages [V]",
            "n_inputs": m,
            "n_outputs": p,
            "n_entering": self.shape.entering,
            "n_leaving": self.shape.leaving,
            "sample_time": interval(self.request.sample_time_s),
            "bound": repr(VOLTAGE_V.high if self.is_model else POSITION_UM.high),
            "step_comment": self._step_comment(),
        }

    def title(self) -> str:
        """Return one line that says what it is."""
        what = "the model itself" if self.is_model else f"law {self.request.law}"
        return f"{what} of {self.model.name}"

    def _step_comment(self) -> str:
        if self.is_model:
            return "One sample: absolute voltages, and the positions of the actuator."
        ahead = self.block.preview_samples
        late = f" for the reference {ahead} samples ago" if ahead else ""
        return f"One sample: the reference is zero at the start; the absolute voltages{late}."

    def _rendered(self, template: str, measured: MeasuredCode | None) -> str:
        part = self._part
        last = np.zeros(self.block.n_outputs) if self.is_model else self.block.range.start_v
        text = rendered(
            template,
            **self.context(),
            **part.values,
            sizes=part.sizes,
            tables=[_Written(table, self.real) for table in part.tables],
            indices=[_Written(table, self.real) for table in part.indices],
            at_start=initializer({**part.start, "last": last}),
            about=[] if measured is None else self._about(measured),
        )
        return in_single_precision(text) if self.request.float32 else text

    @cached_property
    def _part(self) -> CPart:
        return c_law_of(self.block)

    # ---- what stands at the top ----

    def _about(self, measured: MeasuredCode) -> list[str]:
        lines: list[str] = []
        for text in (*self.statements(), self._cost_words(measured), *self.precision(measured)):
            lines += [*textwrap.wrap(text, 104), ""]
        return lines[:-1]

    def statements(self) -> list[str]:
        """Origin of the code, and conditions for its use."""
        request, limits = self.request, self.block.range
        options = "".join(f", {name} = {value}" for name, value in sorted(request.options.items()))
        said = [
            f"Generated from {request.source}, digest {self.model.digest()}: law "
            f"{request.law}{options}, sample time {interval(request.sample_time_s)}.",
            f"Verdict: {_verdict(self.model)}",
        ]
        if isinstance(self.block, ForwardModel):
            return [*said, self.block.statement()]
        start = ", ".join(f"{u:.6g} V" for u in limits.start_v)
        if limits.conditioned:
            low, top = (", ".join(f"{u:.6g} V" for u in ends) for ends in limits.conditioning_v)
            start += f", to which it came from {top}, then {low}"
        said.append(
            f"The drive stays within {limits.words(self.model.inputs)}. Before the first sample the "
            f"actuator is at {start}; the reference is zero there."
        )
        if ahead := self.block.preview_samples:
            said.append(
                f"The output at sample k is the drive for the reference of sample k - {ahead}: call step "
                f"{'once' if ahead == 1 else f'{ahead} times'} with the path before the first drive is due, "
                f"or accept its delay of {interval(ahead * request.sample_time_s)}."
            )
        kind = COMPENSATORS.kinds[request.law]
        also = (
            _left_by_dynamics(self.model, request.sample_time_s) if kind.static else "",
            self.block.statement(),
        )
        return [*said, *filter(None, also)]

    def _cost_words(self, measured: MeasuredCode) -> str:
        cost = self.cost
        found = "there was no C compiler to search for the worst case"
        if measured.operations is not None:
            found = f"a search for the worst case over {measured.samples} samples found {measured.operations}"
        return (
            f"A step takes at most {cost.operations} operations (arithmetic, comparisons, "
            "assignments; an upper bound counted through this file, where every loop has a constant "
            f"bound); {found}. RAM: {cost.state_bytes} bytes for each law, and the stack of a few "
            f"calls. ROM: {cost.constant_bytes} bytes of tables, and the code."
        )

    def precision(self, measured: MeasuredCode) -> list[str]:
        """Say what single precision loses, or that nothing is lost."""
        if self.request.float32:
            return [
                "All computations use single precision. Compared with double precision, the output "
                f"differs by {measured.loss_rms:.2g} {self._unit} rms, {measured.loss_max:.2g} "
                f"{self._unit} at most over the sine at the beginning of golden.csv."
            ]
        return [
            "The numbers equal those of hammerstein's own step to the last bit, with "
            "-ffp-contract=off; fused multiply-adds change the last digits."
        ]

    @property
    def _unit(self) -> str:
        return "um" if self.is_model else "V"


class _Written:
    """A table as text; ends of the range are rounded inwards in single precision."""

    def __init__(self, table: Table, real: str):
        values = np.asarray(table.values)
        if real == "float" and table.name in INWARDS:
            single = values.astype(np.float32)
            outside = INWARDS[table.name] * (single.astype(np.float64) - values) < 0.0
            way = np.float32(INWARDS[table.name] * np.inf)
            values = np.where(outside, np.nextafter(single, way), single).astype(np.float64)
        self.name, self.what, self.shape = table.name, table.what, C(table.shape)
        self.text = initializer(values if values.shape else values.item())


def _verdict(model: HammersteinModel) -> str:
    """Verdict of the identification of the model."""
    verdict = model.verdict
    if verdict is None:
        return "none; the model file does not state how it was identified."
    if verdict.flagged:
        return "FLAGGED by its fit report: " + "; ".join(verdict.statements or ("see there",)) + "."
    error = verdict.error(model.outputs)
    if error:
        return f"not flagged; error {error}."
    return f"not flagged ({'tested by a' if verdict.held_out else 'without a'} validation record)."


def _left_by_dynamics(model: HammersteinModel, sample_time_s: float) -> str:
    """Error of a law without dynamics on sines, and the frequency from which it matters."""
    hertz = np.geomspace(1e-3, 0.5 / sample_time_s, LAG_POINTS)
    lag = discretise(model.dynamics, sample_time_s).lag(hertz)
    ends = [(share, hertz[np.argmax(lag > share)]) for share in LAGS if (lag > share).any()]
    if not ends:
        return ""
    told = " and ".join(f"{100.0 * share:g} % of a sine from {f:.2g} Hz on" for share, f in ends)
    return f"This law ignores the dynamics, which adds an error of {told} to the model's own error."


def rendered(template: str, **content: Any) -> str:
    """Fill a template of the export; its name tells the language."""
    form = PurePath(template.removesuffix(".jinja")).suffix
    return str(_environment(TARGETS.get(form, C)).get_template(template).render(**content))


@cache
def _environment(target: type[Markup]) -> Any:
    """Templates of the export in a language, compiled once."""
    from jinja2 import pass_context

    found = templates_of("hammerstein.export", target)

    @pass_context
    def beside(context: Any, part: Beside, macro: str) -> C:
        return part.text(macro, found, context.get_all())

    found.globals["beside"] = beside
    found.filters["comment"] = C.comment
    found.tests["calling"] = lambda text, name: re.search(rf"\b{name}\(", str(text)) is not None
    return found
