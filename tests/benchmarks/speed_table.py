"""The table of the guide's page on speed, from the benchmark that is committed beside this file.

    python -m pytest -n 0 tests/benchmarks --short          measure, as .ci/run does
    python tests/benchmarks/speed_table.py --keep      keep that, and write the table
    python tests/benchmarks/speed_table.py             print it

``test_speed_table`` compares the page with the benchmark that is committed.
"""

from __future__ import annotations

import json
import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
KEPT = Path(__file__).parent / "measured.json"
NEW = ROOT / "reports" / "benchmarks" / "benchmarks.json"
PAGE = ROOT / "hammerstein" / "guide" / "speed.md"
BEGIN, END = "Processor time for", "The benchmark writes"
SINES, NOISE = "Hysteresis, 2 x 2, 50 Hz sines", "Hysteresis, 2 x 2, white noise"
LAWS = "Compensators, 2 x 2, 15 operators, 50 Hz sines"
LAW_NAMES = ("none", "exact_inverse", "inverse_multiplicative", "decoupled_inverse", "hammerstein_inverse")
DIAGRAM = "{} times as fast as `control.interconnect`"
BEST = "Hysteresis, 2 x 2, against the best strict textbook loop"
OPERATORS = (5, 15, 30, 60, 200)
STEPS, RUN_LAWS = "Whole experiment against the sum", ("exact_inverse", "inverse_multiplicative")
WAIT = "Processor time of what a person waits for"
STEP = "One sample of a law in Python (step)"


@dataclass(frozen=True)
class Line:
    """One line of a table: the row of the benchmark whose words begin so, and what its ratio is."""

    words: str
    group: str
    what: str
    against: str = ""
    ratio: str = ""

    def row(self, measured: dict[str, Any]) -> dict[str, Any]:
        """Row of the benchmark; an error where there is none."""
        found, *_ = [
            row
            for row in measured["rows"]
            if row["group"].startswith(self.group)
            and row["what"].startswith(self.what)
            and row["against"].startswith(self.against)
            and not row["against"].endswith("fast-math")
        ]
        return dict(found)

    def cells(self, measured: dict[str, Any]) -> tuple[str, str, str]:
        """Its cells."""
        row = self.row(measured)
        return self.words, _time(row["ours"], row["unit"]), self.ratio.format(_digits(row["ratio"]))


LINES = (
    Line(
        "15 operators, sines",
        SINES,
        "15 operators",
        "textbook",
        "{} times as fast as the textbook loop, both compiled",
    ),
    Line("15 operators, sines", SINES, "15 operators", "copy", "{} times the time to copy its arrays"),
    Line("150 operators, sines", SINES, "150 operators", "textbook", "{} times as fast as the textbook loop"),
    Line("1500 operators, sines", SINES, "1500 operators", "textbook", "{} times as fast"),
    Line("15 operators, white noise", NOISE, "15 operators", "textbook", "{} times as fast"),
    Line("60 operators, white noise", NOISE, "60 operators", "textbook", "{} times as fast"),
    Line("hysteresis, then dynamics", "Hysteresis and dynamics", "hysteresis, then", "control", DIAGRAM),
    Line("`exact_inverse`, 15 operators", LAWS, "exact_inverse", "forward", "{} times the forward model"),
    Line(
        "`inverse_multiplicative`, 15 operators",
        LAWS,
        "inverse_multiplicative",
        "forward",
        "{} times the forward model",
    ),
    Line(
        "`exact_inverse` exported as C",
        "exact_inverse exported",
        "C, compiled",
        "batch",
        "{} times the compiled loop in Python",
    ),
    Line(
        "one step of this C code, median",
        "exact_inverse exported",
        "C, median",
        "its worst",
        "the slowest step takes {} times as long",
    ),
    *(Line(f"one step in Python, `{name}`", STEP, name) for name in LAW_NAMES),
    Line("whole experiment", "Whole experiment", "circle", "control", DIAGRAM),
    Line("`identify`, 15 operators, 100,000 samples", WAIT, "identify, 2 x 2"),
    Line("`hammerstein --help`", WAIT, "hammerstein --help"),
    Line(
        "20 million samples in blocks of a million",
        "Peak memory",
        "whole experiment, a million",
        "arrays kept",
        "{} times the arrays of a block",
    ),
)


def _digits(value: float) -> str:
    """Two digits, as a person writes them."""
    return f"{float(f'{value:.2g}'):,.10g}"


def _time(value: float, unit: str) -> str:
    if unit == "ns" and value >= 1000.0:
        return f"{_digits(value / 1000.0)} us"
    return f"{_digits(value)} {unit}"


def kept() -> dict[str, Any]:
    """The benchmark that is committed."""
    return dict(json.loads(KEPT.read_text(encoding="utf-8")))


def table(measured: dict[str, Any]) -> str:
    """The table, and where it was measured."""
    machine = measured["machine"]
    lines = [
        "Processor time for two inputs and two outputs; for loops, the time of one sample. Times depend on "
        "the machine, ratios much less.",
        f"Measured on {measured['date']} by `{measured['command']}`: {machine['cores']} cores "
        f"({machine['processor']}), load {machine['load']}, Python {machine['python']}.",
        "",
        "| task | time | ratio |",
        "| --- | ---: | --- |",
        *(f"| {' | '.join(line.cells(measured))} |" for line in LINES),
        "",
        *textwrap.wrap(beside(measured), 120, break_on_hyphens=False),
    ]
    return "\n".join(lines)


def beside(measured: dict[str, Any]) -> str:
    """What is beside the table: the textbook loop on a grid, and what a run costs beside its steps."""
    ratios = {
        signal: [Line("", BEST, f"{n} operators, {signal}").row(measured)["ratio"] for n in OPERATORS]
        for signal in ("noise", "walk", "sines")
    }
    noise, walk, sines = (listed([_digits(r) for r in ratios[s]]) for s in ratios)
    steps = sorted(
        {_digits(Line("", STEPS, law, "reference, law").row(measured)["ratio"]) for law in RUN_LAWS}
    )
    return (
        f"At {listed(map(str, OPERATORS))} operators the kernel has {noise} times the speed of the best "
        f"strict textbook loop on white noise, {walk} times on a random walk, {sines} times on sines. A run "
        f"takes {' to '.join(steps)} times the sum of its parts, with the figures of merit."
    )


def listed(words: Iterable[str]) -> str:
    """Join them as a person writes them."""
    *first, last = words
    return f"{', '.join(first)} and {last}"


def between(page: str) -> str:
    """Part of the page that is made here."""
    return BEGIN + page.split(BEGIN)[1].split(END)[0].rstrip()


def main(arguments: Sequence[str]) -> int:
    """Do what the command line asks for."""
    if "--keep" in arguments:
        shutil.copy(NEW, KEPT)
    made = table(kept())
    print(made)
    if "--keep" in arguments:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(page.replace(between(page), made), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
