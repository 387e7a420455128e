"""How far identification with the defaults can be trusted, on actuators drawn at random.

    python -m tests.random_actuators --seeds 200 --out tests/random_actuators/results.md

A run that is stopped goes on where it was, from the file beside the table. The exit code is 1 where a figure
is not reached.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from .trial import Outcome, tried
from .truth import SHAPES

COLUMNS = (
    *("records", "actuators", "refused", "stated error 0.7 to 1.5 of the true one"),
    *("chosen within 10 % of the best", "stated numbers off by over 3 standard errors"),
    *(
        "error of another record 0.7 to 1.5 of the true one",
        "rms of 6 other records 0.7 to 1.5 of the true one",
    ),
)
HEAD = f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}\n"


def row(name, outcomes):
    """Line of the table, and the three shares."""
    done = [one for one in outcomes if not one.refused]
    honest, best = sum(one.honest for one in done), sum(one.best_chosen for one in done)
    stated, missed = sum(len(one.stated) for one in done), sum(len(one.missed) for one in done)
    n = max(len(done), 1)
    text = f"| {name} | {len(outcomes)} | {len(outcomes) - len(done)} | {honest} of {len(done)} "
    chance = [f"{sum(getattr(one, name) for one in done)} of {len(done)}" for name in ("alike", "foreseen")]
    return f"{text}| {best} of {len(done)} | {missed} of {stated} | {' | '.join(chance)} |", (
        honest / n,
        best / n,
        missed / max(stated, 1),
    )


def main():
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.random_actuators")
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    kept = asked.out.with_suffix(".json")
    known = json.loads(kept.read_text()) if kept.exists() else {}
    for seed in range(asked.seeds):
        if str(seed) not in known:
            known[str(seed)] = asdict(tried(seed))
            kept.write_text(json.dumps(known, indent=1))
            print(known[str(seed)], flush=True)
    outcomes = [Outcome(**known[str(seed)]) for seed in range(asked.seeds)]
    lines = [row(shape, [one for one in outcomes if one.shape == shape])[0] for shape in SHAPES]
    last, (honest, best, missed) = row("all", outcomes)
    asked.out.write_text(HEAD + "\n".join([*lines, last]) + "\n")
    print(last)
    return int(not (honest >= 0.9 and best >= 0.9 and missed <= 0.02))


if __name__ == "__main__":
    sys.exit(main())
