"""The table of kinds in the guide: median and range over ten seeds of noise.

    python tests/kinds_figures.py            print it (about five minutes)
    python tests/kinds_figures.py --write    put it into the guide

``test_guide`` compares the accepted numbers of one seed with it.
"""

from __future__ import annotations

import re
import statistics
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "hammerstein/guide/kinds.md"
SEEDS = tuple(range(1, 11))
FREQUENCIES_HZ = (20.0, 50.0, 100.0)
METRIC = "euclidean_max_true_um"
ROW = re.compile(r"^\| ([^|]+) \|((?: [\d.]+ \([\d.]+ to [\d.]+\) \|)+)$", re.MULTILINE)


def values(seed: int) -> dict[str, list[float]]:
    """Figure of each compensator at each frequency with one seed."""
    from hammerstein.experiment.run import run
    from hammerstein.scenario import load_scenario

    report = run(load_scenario(ROOT / "scenarios/kinds_circle.toml").model_copy(update={"seed": seed}))
    found: dict[str, list[float]] = {}
    for row in report.rows:
        if row.measured_axis == "x":
            found.setdefault(row.compensator, []).append(float(row.figures[METRIC]))
    return found


def table(seeds: Sequence[int] = SEEDS) -> list[str]:
    """Rows: median, least and largest value at each frequency."""
    found = [values(seed) for seed in seeds]
    return [
        f"| {label} | {' | '.join(_cell([one[label][i] for one in found]) for i in range(3))} |"
        for label in found[0]
    ]


def _cell(own: Sequence[float]) -> str:
    return f"{statistics.median(own):.3g} ({min(own):.3g} to {max(own):.3g})"


def printed(page: str) -> dict[str, list[tuple[float, float, float]]]:
    """Median, least and largest value of each compensator at each frequency, as the guide prints them."""
    cell = re.compile(r"([\d.]+) \(([\d.]+) to ([\d.]+)\)")
    return {
        label: [(float(m), float(low), float(high)) for m, low, high in cell.findall(cells)]
        for label, cells in ROW.findall(page)
    }


def main(arguments: Sequence[str]) -> int:
    """Do what the command line asks for."""
    rows = table()
    print("\n".join(rows))
    if "--write" in arguments:
        page = PAGE.read_text(encoding="utf-8")
        first, last = page.index("| --- | ---: | ---: | ---: |\n"), page.index("\n\nThe Bouc-Wen compensator")
        head = first + len("| --- | ---: | ---: | ---: |\n")
        PAGE.write_text(page[:head] + "\n".join(rows) + page[last:], encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
