"""The errors in the README and in the paper of the package: ranges over twelve seeds and two sample times.

    python tests/readme_figures.py            print it (about ten minutes)
    python tests/readme_figures.py --write    put its lines into the README and .github/paper.md
    python tests/readme_figures.py --check    exit code 1 where one of them says something else

``test_readme_figures`` runs one seed of it.
"""

from __future__ import annotations

import itertools
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
TEXTS = (README, ROOT / ".github/paper.md")
SEEDS = tuple(range(1, 13))
SAMPLE_TIMES_S = (50e-6, 25e-6)
"""Of the records and of the run: a figure that rests on one grid shows on the other."""
HEADER = ("| error of the true position, twelve seeds of noise, 50 and 25 us | [um] |", "| --- | ---: |")
PAPER = ("paper, 50 Hz", "paper, 100 Hz", "paper, 150 Hz", "paper, 200 Hz")


@dataclass(frozen=True)
class Figure:
    """One line of the table: all values of a figure in the rows of some compensators.

    words : what stands in the line; scenario : its file; labels : compensators
    metric : figure of merit, in um; amplitude_um : of the path, where the scenario has several
    """

    words: str
    scenario: str
    labels: tuple[str, ...]
    metric: str = "euclidean_max_true_um"
    amplitude_um: float | None = None

    def values(self, seed: int, sample_time_s: float) -> list[float]:
        """Values with one seed and sample time [s]."""
        from hammerstein.experiment.run import run
        from hammerstein.scenario import load_scenario

        whole = load_scenario(ROOT / "scenarios" / f"{self.scenario}.toml")
        drive = whole.instruments.drive.model_copy(update={"sample_time_s": sample_time_s})
        changes = {"instruments": whole.instruments.model_copy(update={"drive": drive}), "seed": seed}
        # all compensators: the noise of an identification follows from its place among them
        report = run(whole.model_copy(update={**changes, "assessment": None}))
        return [
            float(row.figures[self.metric])
            for row in report.rows
            if row.compensator in self.labels
            and self.amplitude_um in (None, row.amplitude_um)
            and row.excited_axis in ("all", row.measured_axis)
        ]


DYNAMICS = ("with dynamics",)
FIGURES = (
    Figure("rms, sines of 20 um, 10 to 420 Hz: with dynamics", "beyond_error", DYNAMICS, "rms_true_um"),
    Figure("rms, the same sines: the paper's compensators", "beyond_error", PAPER, "rms_true_um"),
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
)


def line(figure: Figure, values: Iterable[float]) -> str:
    """Line of the table with the least and the largest value."""
    found = list(values)
    return f"| {figure.words} | {_two_digits(min(found))} to {_two_digits(max(found))} |"


def _two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"


def printed(readme: str) -> dict[str, tuple[float, float]]:
    """Range of each line of the table as the README prints it."""
    found = {}
    for row in readme.splitlines():
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        if len(cells) == 2 and cells[0] in {figure.words for figure in FIGURES}:
            low, high = cells[1].split(" to ")
            found[cells[0]] = (float(low), float(high))
    return found


def table(seeds: Sequence[int] = SEEDS) -> dict[str, str]:
    """Give every line of the table by its words."""
    every = list(itertools.product(seeds, SAMPLE_TIMES_S))
    return {
        figure.words: line(figure, [v for one in every for v in figure.values(*one)]) for figure in FIGURES
    }


def written(text: str, lines: Mapping[str, str]) -> str:
    """Put the lines of the table in the place of those with the same words."""
    return "\n".join(lines.get(row.strip("|").split("|")[0].strip(), row) for row in text.split("\n"))


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
