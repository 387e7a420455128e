"""The errors in the README, the paper of the package and its guide: twelve seeds and two sample times.

    python tests/readme_figures.py            print them (about ten minutes)
    python tests/readme_figures.py --write    put the lines into README.md, .github/paper.md and the guide
    python tests/readme_figures.py --check    exit code 1 where one of them says something else

``test_readme_figures`` runs one seed of it.
"""

from __future__ import annotations

import itertools
import re
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from hammerstein.experiment.report import Row

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
TEXTS = (README, ROOT / ".github/paper.md", ROOT / "hammerstein/guide/compensators.md")
SEEDS = tuple(range(1, 13))
SAMPLE_TIMES_S = (50e-6, 25e-6)
"""Of the records and of the run: a figure that rests on one grid shows on the other."""
HEADER = (
    "| simulated error of the true position; twelve seeds of noise, sample times of 50 and 25 us | [um] |",
    "| --- | ---: |",
)
PAPER = ("paper, 50 Hz", "paper, 100 Hz", "paper, 150 Hz", "paper, 200 Hz")


@dataclass(frozen=True)
class Figure:
    """One line of a table: all values of a figure in the rows of some compensators.

    words : what stands in the line; scenario : its file; labels : compensators
    metric : figure of merit, in um; amplitude_um : of the path, where the scenario has several
    frequencies_hz : one cell each, with its median; one range over all frequencies if there are none
    heading : what stands above the words, in a table that shares them with others
    """

    words: str
    scenario: str
    labels: tuple[str, ...]
    metric: str = "euclidean_max_true_um"
    amplitude_um: float | None = None
    frequencies_hz: tuple[float, ...] = ()
    heading: str = ""

    @property
    def key(self) -> tuple[str, str]:
        """What a line is found by."""
        return self.heading, self.words

    def cells(self, cases: Sequence[tuple[int, float]]) -> list[list[float]]:
        """Values of each cell with some seeds and sample times [s]."""
        rows = [
            row
            for one in cases
            for row in rows_of(self.scenario, *one)
            if row.compensator in self.labels
            and self.amplitude_um in (None, row.amplitude_um)
            and row.excited_axis in ("all", row.measured_axis)
        ]
        return [
            [float(row.figures[self.metric]) for row in rows if asked in (None, row.frequency_hz)]
            for asked in self.frequencies_hz or (None,)
        ]


@cache
def rows_of(scenario: str, seed: int, sample_time_s: float) -> tuple[Row, ...]:
    """Rows of a scenario with another seed and sample time [s], of all its compensators.

    The noise of an identification follows from its place among them.
    """
    from hammerstein.experiment.run import run
    from hammerstein.scenario import load_scenario

    whole = load_scenario(ROOT / "scenarios" / f"{scenario}.toml")
    drive = whole.instruments.drive.model_copy(update={"sample_time_s": sample_time_s})
    changes = {"instruments": whole.instruments.model_copy(update={"drive": drive}), "seed": seed}
    return run(whole.model_copy(update={**changes, "assessment": None})).rows


def _by_frequency(
    heading: str, scenario: str, labels: Sequence[str], metric: str, frequencies_hz: tuple[float, ...]
) -> Iterator[Figure]:
    """One line for each compensator, one cell for each frequency."""
    for label in labels:
        yield Figure(label, scenario, (label,), metric, None, frequencies_hz, heading)


DYNAMICS = ("with dynamics",)
FIGURES = (
    Figure("rms, sines of 20 um, 10 to 420 Hz: with dynamics", "beyond_error", DYNAMICS, "rms_true_um"),
    Figure("rms, the same sines: the paper's compensators", "beyond_error", PAPER, "rms_true_um"),
    Figure("rms, the same sines: no compensation", "beyond_error", ("no compensation",), "rms_true_um"),
    Figure("worst, circles of 50 um at 50, 100, 200 Hz: with dynamics", "beyond_circles", DYNAMICS),
    Figure("worst, spiral from 50 um: with dynamics", "beyond_spiral", DYNAMICS),
    Figure("worst, Lissajous 3:2, 48 um: with dynamics", "beyond_lissajous_3_2", DYNAMICS, amplitude_um=48.0),
    Figure("worst, Lissajous 4:3, 48 um: with dynamics", "beyond_lissajous_4_3", DYNAMICS, amplitude_um=48.0),
    Figure(
        "worst, circle of 50 um, actuator with 28 other thresholds: the paper's partition",
        "beyond_other_thresholds",
        ("thresholds uniform in time",),
    ),
    Figure(
        "worst, the same circle and actuator: fitted thresholds",
        "beyond_other_thresholds",
        ("fitted thresholds",),
    ),
    *_by_frequency(
        "50 um circle, largest distance [um]",
        "beyond_circles",
        (
            "paper, 50 Hz",
            "exact, static",
            "with dynamics",
            "no compensation",
            "PI feedback",
            "PID feedback",
            "gain and PID feedback",
            "with dynamics and PI feedback",
        ),
        "euclidean_max_true_um",
        (50.0, 100.0, 200.0),
    ),
    *_by_frequency(
        "20 um sine, rms error [um]",
        "beyond_error",
        (*PAPER, "decoupled, 50 Hz", "no compensation", "with dynamics"),
        "rms_true_um",
        (10.0, 100.0, 300.0),
    ),
)


def line(figure: Figure, cells: Sequence[Sequence[float]]) -> str:
    """Line of a table: in each cell the least and the largest value, for one frequency also the median."""
    told = []
    for values in cells:
        low, middle, high = (_two_digits(float(x)) for x in np.quantile(values, [0.0, 0.5, 1.0]))
        told.append(f"{middle} ({low} to {high})" if figure.frequencies_hz else f"{low} to {high}")
    return f"| {' | '.join([figure.words, *told])} |"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def _keyed(text: str) -> Iterator[tuple[tuple[str, str], str]]:
    """Lines of a text, each with the heading of the table that it stands in and its first cell."""
    heading, inside = "", False
    for row in text.split("\n"):
        first = row.strip("|").split("|")[0].strip()
        if not inside:
            heading = first
        inside = row.startswith("|")
        yield (heading, first), row


def _found(key: tuple[str, str], known: Mapping[tuple[str, str], str]) -> str | None:
    """What is known of a line: words that no other table has need no heading."""
    return known.get(key) or known.get(("", key[1]))


def printed(text: str) -> dict[tuple[str, str], list[tuple[float, float]]]:
    """Ranges of the cells of each figure as a text prints them."""
    words = {figure.key: figure.words for figure in FIGURES}
    return {
        key if key in words else ("", key[1]): [
            (float(low), float(high))
            for low, high in re.findall(r"([\d.e-]+) to ([\d.e-]+)", row.partition(key[1])[2])
        ]
        for key, row in _keyed(text)
        if row.startswith("|") and _found(key, words)
    }


def table(seeds: Sequence[int] = SEEDS) -> dict[tuple[str, str], str]:
    """Give every line of the tables by its heading and words."""
    every = list(itertools.product(seeds, SAMPLE_TIMES_S))
    return {figure.key: line(figure, figure.cells(every)) for figure in FIGURES}


def written(text: str, lines: Mapping[tuple[str, str], str]) -> str:
    """Put the lines of the tables in the place of those with the same heading and words."""
    return "\n".join(_found(key, lines) or row for key, row in _keyed(text))


def main(arguments: Sequence[str]) -> int:
    """Do what the command line asks for."""
    import os

    with tempfile.TemporaryDirectory() as fresh:  # most lines take the same identification
        os.environ["HAMMERSTEIN_CACHE"] = fresh
        lines = table()
    print(*HEADER, *lines.values(), sep="\n")
    for path in TEXTS:
        before = path.read_text(encoding="utf-8")
        after = written(before, lines)
        if "--write" in arguments:
            path.write_text(after, encoding="utf-8")
        elif "--check" in arguments and before != after:
            print(f"\n{path} says something else: python tests/readme_figures.py --write", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
