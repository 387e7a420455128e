"""Change single lines of the numerical modules, and see whether tests and ``hammerstein check`` notice.

    python -m tests.mutation record               tests of numbers and scenarios under coverage, once
    python -m tests.mutation record tests/a.py    tests that were added since
    python -m tests.mutation run --number 200 --seed 0
    python -m tests.mutation known                changes that once went unnoticed

Needs ``pip install coverage`` besides the test tools, and a system that forks. A run that is stopped, or
whose budget ends, goes on where it was. The exit code is 1 where more than a tenth survives, or a known one.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from .changes import Change, changes_of
from .recording import ROOT, Recording, copied, record
from .trial import load_libraries, outcome, restore

KNOWN = Path(__file__).parent / "known.toml"
UNNOTICED = ("survived", "untouched")
MOST_SURVIVORS = 0.1


def sample(number: int, seed: int, tree: Path) -> list[Change]:
    """Changes of lines chosen at random, one a line; a larger number adds to a smaller one."""
    generator = random.Random(seed)
    lines: dict[tuple[str, int], list[Change]] = {}
    for change in changes_of(tree):
        lines.setdefault((change.path, change.line), []).append(change)
    places = sorted(lines)
    generator.shuffle(places)
    return [random.Random(f"{seed} {place}").choice(lines[place]) for place in places[:number]]


def known(root: Path) -> dict[Change, str]:
    """Changes that are listed, with the test file to try first; each text must stand once in its file."""
    changes = {}
    for entry in tomllib.loads(KNOWN.read_text())["change"]:
        source = (root / entry["path"]).read_text()
        if source.count(entry["old"]) != 1:
            raise SystemExit(
                f"{KNOWN.name}: {entry['path']} holds {entry['old']!r} {source.count(entry['old'])} times"
            )
        before = source[: source.index(entry["old"])]
        start = len(before) - before.rfind("\n") - 1
        line = before.count("\n") + 1
        change = Change(entry["path"], line, start, start + len(entry["old"]), entry["new"])
        changes[change] = entry.get("test", "")
    return changes


def tried(
    kept: Path, changes: Mapping[Change, str], budget_s: float, most_s: tuple[float, float], again: bool
) -> dict[Change, str]:
    """What came of each change, from earlier runs or now, until the budget ends.

    changes : with the test file to try first; where none is said, that which noticed the last one of the file
    """
    results = kept / "results.jsonl"
    rows = [json.loads(row) for row in results.read_text().splitlines()] if results.exists() else []
    before = {Change(**row["change"]): row["outcome"] for row in rows}
    recording, found = Recording.read(kept), {}
    killers: dict[str, str] = {}
    if not recording.seconds:
        raise SystemExit(f"nothing is recorded in {kept}: python -m tests.mutation record")
    load_libraries()
    end = time.monotonic() + budget_s
    for change, first in changes.items():
        if change in before and not (again and before[change] in UNNOTICED):
            found[change] = before[change]
        elif time.monotonic() < end:
            begun = time.monotonic()
            killers |= {change.path: first} if first else {}
            found[change] = outcome(kept, recording, change, most_s, killers)
            took = time.monotonic() - begun
            told = change.told((kept / "tree" / change.path).read_text())
            print(f"{found[change]:9} {took:5.1f} s  {told}", flush=True)
            with results.open("a") as file:
                file.write(json.dumps({"change": vars(change), "outcome": found[change]}) + "\n")
    return found


def main() -> int:
    """Do what the command line asks for."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=["record", "run", "known"])
    parser.add_argument("paths", nargs="*", help="test files to record anew")
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--budget-s", type=float, default=7200.0)
    parser.add_argument("--tests-s", type=float, default=90.0, help="most time of tests for one change")
    parser.add_argument(
        "--check-s", type=float, default=math.inf, help="most time of scenarios for one change"
    )
    parser.add_argument("--again", action="store_true", help="try survivors of earlier runs again")
    parser.add_argument("--kept", type=Path, default=ROOT / "reports" / "mutation")
    asked = parser.parse_args()
    kept = asked.kept.resolve()
    tree = kept / "tree"
    if asked.what == "record":
        copied(tree, asked.paths if tree.exists() else ())
        return 0 if record(kept, asked.paths) else 1
    restore(kept)
    changes = (
        known(tree) if asked.what == "known" else dict.fromkeys(sample(asked.number, asked.seed, tree), "")
    )
    again = asked.again or asked.what == "known"
    found = tried(kept, changes, asked.budget_s, (asked.tests_s, asked.check_s), again)
    survivors = [change for change, came in found.items() if came in UNNOTICED]
    print(f"\n{len(found)} of {len(changes)} tried: {dict(Counter(found.values()))}")
    for change in survivors:
        print(f"survivor: {change.told((tree / change.path).read_text())}")
    most = 0 if asked.what == "known" else MOST_SURVIVORS * len(found)
    return int(len(survivors) > most)


if __name__ == "__main__":
    sys.exit(main())
