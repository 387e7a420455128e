"""The long campaign: ``python -m tests.fuzz --scenarios 10000 --models 5000 --records 5000``.

Every finding is printed with the file that brought it about; the exit code is the number of kinds found.
"""

from __future__ import annotations

import argparse
import collections
import random
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from . import campaign, strategies

SLOW_S = 60.0


class Tally:
    """What became of the cases, and the first of each kind of finding."""

    def __init__(self, keep: Path):
        self.codes: dict[str, collections.Counter[int]] = collections.defaultdict(collections.Counter)
        self.findings: dict[str, str] = {}
        self.keep = keep

    def case(self, kind: str, work: Callable[[], int], folder: Path) -> None:
        """Do one case and note what came of it."""
        begin = time.monotonic()
        try:
            self.codes[kind][work()] += 1
        except Exception as error:
            words = f"{type(error).__name__}: {error}"
            name = re.sub(r"0x[0-9a-f]+|[0-9.e+-]+|'[^']*'", "_", words)[:150]
            if name not in self.findings:
                self.findings[name] = words
                shutil.copytree(folder, self.keep / f"{kind}_{len(self.findings)}", dirs_exist_ok=True)
                sys.stdout.write(f"{kind}: {words[:600]}\n")
        if time.monotonic() - begin > SLOW_S:
            self.findings[f"{kind} slow"] = f"{time.monotonic() - begin:.0f} s"


def from_strategy(strategy: Any, count: int, number: int, work: Callable[[Any], None]) -> None:
    """So many examples of a strategy."""

    @seed(number)
    @settings(max_examples=max(count, 1), database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(strategy)
    def each(content: Any) -> None:
        work(content)

    if count:
        each()


def _one(tally: Tally, kind: str, work: Callable[[Any, Path], int], folder: Path, content: Any) -> None:
    tally.case(kind, lambda: work(content, folder), folder)


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    for name in ("scenarios", "models", "records", "baselines", "files"):
        parser.add_argument(f"--{name}", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hammerstein_fuzz")
    asked = parser.parse_args()
    draw, tally = random.Random(asked.seed), Tally(asked.keep)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, strategy, count, work in (
            ("scenario", strategies.scenarios(), asked.scenarios, campaign.scenario_case),
            ("model", strategies.models(), asked.models, campaign.model_case),
        ):
            each = partial(_one, tally, kind, work, folder)
            from_strategy(strategy, count, asked.seed, each)
        seeds, files = campaign.records(folder), list(campaign.shipped())
        for _ in range(asked.records):
            file, data, columns = draw.choice(seeds)
            damaged = campaign.mutated(data, draw)
            case = file.replace("seed", "case")
            tally.case(
                "record", lambda d=damaged, n=case, c=columns: campaign.record_case(d, n, c, folder), folder
            )
        baseline = next(data for file, data in files if file == "static_inverse.json")
        for _ in range(asked.baselines):
            damaged = campaign.mutated(baseline, draw)
            tally.case("baseline", partial(campaign.baseline_case, damaged, folder), folder)
        for _ in range(asked.files):
            file, data = draw.choice([f for f in files if f[0].endswith(".toml")])
            damaged = campaign.mutated(data, draw)
            tally.case("file", partial(campaign.file_case, damaged, folder), folder)
    for kind, codes in tally.codes.items():
        sys.stdout.write(
            f"{kind}: " + ", ".join(f"{n} with {code}" for code, n in sorted(codes.items())) + "\n"
        )
    for words in tally.findings.values():
        sys.stdout.write(f"FOUND {words[:2000]}\n")
    return len(tally.findings)


if __name__ == "__main__":
    sys.exit(main())
