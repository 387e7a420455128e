"""How often the true error lies in the 5-95 % band of a model's covariance, by kind, partition and dynamics.

    python -m tests.coverage_of_bands --seeds 60 --out tests/coverage_of_bands/results.md

Each row draws so many actuators; nine tenths of the true errors should lie in their bands. A run that is
stopped goes on where it was, from the file beside the table. The exit code is 1 where a row is off by more
than 8 %.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

from hammerstein.errors import SimulationError

from .seeds import KINDS, Found, Kind, found

WANTED_PERCENT, OFF_PERCENT = 90.0, 8.0


def line(kind: Kind, rows: list[Found]) -> tuple[str, bool]:
    """Row of the table, and whether the band holds what it says."""
    covered = 100.0 * np.mean([row.covered for row in rows])
    ratio = np.median([row.true_um / row.median_um for row in rows])
    above = sum(row.true_um > row.high_um for row in rows)
    count = f"{sum(row.covered for row in rows)} of {len(rows)}"
    told = f"| {kind.name} | {count} | {covered:.0f} | {above} | {ratio:.2f} |"
    return told, abs(covered - WANTED_PERCENT) <= OFF_PERCENT


def main() -> int:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.coverage_of_bands")
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    kept = asked.out.with_suffix(".json")
    known = json.loads(kept.read_text()) if kept.exists() else {}
    lines, good = [], True
    for kind in KINDS:
        own = known.setdefault(kind.name, {})
        for seed in range(asked.seeds):
            if str(seed) not in own:
                try:
                    own[str(seed)] = vars(found(kind, seed))
                except SimulationError:  # a path out of reach tells nothing of the band
                    own[str(seed)] = {}
                kept.write_text(json.dumps(known, indent=1))
        row, holds = line(
            kind, [Found(**one) for one in (own[str(seed)] for seed in range(asked.seeds)) if one]
        )
        print(row, flush=True)
        lines.append(row)
        good = good and holds
    head = (
        "| kind, partition, dynamics | true error in the 5-95 % band | % | above | true over median error |\n"
    )
    asked.out.write_text(head + "|---|---|---|---|---|\n" + "\n".join(lines) + "\n")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
