"""The long campaign: ``python -m tests.fuzz --hostile 20000 --scenarios 10000 --models 5000 --options 1000``.

Every finding is printed once, and the files that brought it about are kept; the exit code tells whether there
were any. A campaign that is stopped (SIGTERM, as ``timeout`` sends it, or Ctrl-C) says what it has counted.
"""

from __future__ import annotations

import argparse
import collections
import random
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from . import campaign, hostile, options, strategies
from .workers import SLOW_S, in_a_process

KINDS = ("hostile", "scenarios", "models", "records", "paths", "baselines", "files", "results", "options")
PIECE = 500
"""Cases of one process: what leaks is not carried on for ever."""
CLASSES = {
    "memory": r"large: |the process ended with (3|-9)\b",
    "signal": r"the process ended with -",
    "hang": r"slow: ",
    "warning shown": r"^FindingError: [^\n]*: warns ",
    "nonsense number": r"nonsense number|not finite|a result holds",
    "raw markup": r"raw markup",
    "control character": r"control character",
    "file outside the folder": r"file outside the folder|file of a person",
    "internal error": r"internal error",
    "traceback": r"^(?!FindingError)\w+: |Traceback|exit code (?![0-4]\b)",
}
"""What a finding says, the first that fits; whatever else it says is another class."""
Do = Callable[[Callable[[], int]], None]


class Tally:
    """What became of the cases, and the first of each kind of finding."""

    def __init__(self, folder: Path, keep: Path):
        self.folder, self.keep = folder, keep
        self.codes: dict[str, collections.Counter[int]] = collections.defaultdict(collections.Counter)
        self.findings: dict[str, int] = {}
        self.classes: collections.Counter[str] = collections.Counter()
        self.slowest_s: dict[str, float] = collections.defaultdict(float)
        self.total_s = 0.0

    def told(self, kind: str, code: int | None, found: str, seconds: float) -> None:
        """Note what came of a case."""
        self.total_s += seconds
        self.slowest_s[kind] = max(self.slowest_s[kind], seconds)
        if code is not None:
            self.codes[kind][code] += 1
        if seconds > SLOW_S and not found:
            found = f"slow: {seconds:.0f} s of the processor"
        if found:
            self._keep(kind, found)

    def _keep(self, kind: str, found: str) -> None:
        self.classes[class_of(found)] += 1
        name = re.sub(r"0x[0-9a-f]+|[0-9.e+-]+|'[^']*'", "_", found.partition("\n")[0] + found[-200:])[-300:]
        if name in self.findings:
            self.findings[name] += 1
            return
        self.findings[name] = 1
        place = self.keep / f"{kind}_{len(self.findings)}"
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(self.folder, place, dirs_exist_ok=True, symlinks=True)
        sys.stdout.write(f"FOUND {kind}, kept in {place}: {found[:3000]}\n")
        sys.stdout.flush()

    def text(self) -> str:
        """What happened, in a few lines."""
        lines = []
        for kind, codes in self.codes.items():
            ends = ", ".join(f"{n} with {code}" for code, n in sorted(codes.items()))
            lines.append(
                f"{kind}: {ends.replace('with -1', 'too long')}; slowest {self.slowest_s[kind]:.1f} s"
            )
        lines.append(", ".join(f"{name}: {self.classes[name]}" for name in (*CLASSES, "other")))
        lines.append(f"{self.total_s:.0f} s of the processor, {len(self.findings)} findings")
        return "\n".join(lines) + "\n"


def class_of(found: str) -> str:
    """Class of a finding."""
    return next((name for name, pattern in CLASSES.items() if re.search(pattern, found)), "other")


def from_strategy(strategy: Any, count: int, number: int, work: Callable[[Any], None]) -> None:
    """So many examples of a strategy."""

    @seed(number)
    @settings(max_examples=count, database=None, deadline=None, phases=[Phase.generate],
              suppress_health_check=list(HealthCheck))  # fmt: skip
    @given(strategy)
    def each(content: Any) -> None:
        work(content)

    each()


def pieces(kind: str, folder: Path) -> Callable[[int, int, Do], None]:
    """What does so many cases of a kind from a seed on."""
    made = {
        "scenarios": (strategies.scenarios, campaign.scenario_case),
        "models": (strategies.models, campaign.model_case),
        "options": (options.command_lines, campaign.option_case),
    }
    if kind in made:
        strategy, case = made[kind]
        return partial(_made, strategy(), case, folder)
    mutated = {
        "hostile": _hostile,
        "records": _records,
        "paths": _paths,
        "baselines": _baselines,
        "files": _files,
    }
    return partial({**mutated, "results": _results}[kind], folder)


def _made(
    strategy: Any, case: Callable[[Any, Path], int], folder: Path, count: int, number: int, do: Do
) -> None:
    from_strategy(strategy, count, number, lambda content: do(lambda: case(content, folder)))


def _hostile(folder: Path, count: int, number: int, do: Do) -> None:
    seeds = hostile.Seeds(folder)
    for i in range(count):
        do(partial(hostile.case, random.Random(f"{number} {i}"), seeds, folder))


def _records(folder: Path, count: int, number: int, do: Do) -> None:
    draw, seeds = random.Random(number), campaign.records(folder)
    for i in range(count):
        name, data, columns = draw.choice(seeds)
        damaged, name = campaign.mutated(data, draw), name.replace("seed", "case")
        do(partial(campaign.record_case, damaged, name, columns, folder, fitted=i % 10 == 0))


def _paths(folder: Path, count: int, number: int, do: Do) -> None:
    draw, whole = random.Random(number), campaign.path_bytes()
    for _ in range(count):
        do(partial(campaign.path_case, campaign.mutated(whole, draw), folder))


def _baselines(folder: Path, count: int, number: int, do: Do) -> None:
    draw, own = random.Random(number), campaign.good_baseline(folder)
    shipped = [data for name, data in campaign.shipped() if name.endswith(".json")]
    for _ in range(count):
        whole = own if draw.random() < 0.8 else draw.choice(shipped)
        do(partial(campaign.baseline_case, campaign.mutated(whole, draw), folder))


def _files(folder: Path, count: int, number: int, do: Do) -> None:
    draw, shipped = random.Random(number), list(campaign.shipped())
    for _ in range(count):
        name, data = draw.choice(shipped)
        case = campaign.file_case if name.endswith(".toml") else campaign.model_file_case
        do(partial(case, campaign.mutated(data, draw), folder))


def _results(folder: Path, count: int, number: int, do: Do) -> None:
    draw, made = random.Random(number), campaign.results(folder)
    for _ in range(count):
        name, data = draw.choice(made)
        do(partial(campaign.shown_case, campaign.mutated(data, draw), name, folder))


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    for name in KINDS:
        parser.add_argument(f"--{name}", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path(tempfile.gettempdir()) / "hammerstein_fuzz")
    asked = parser.parse_args()
    if not any(getattr(asked, kind) for kind in KINDS):
        parser.error(f"say how many: {', '.join('--' + kind for kind in KINDS)}")
    campaign.warm_up()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as name:
        tally = Tally(Path(name), asked.keep)
        try:
            for kind in KINDS:
                _run(kind, getattr(asked, kind), asked.seed, tally)
        except KeyboardInterrupt:
            sys.stdout.write("stopped\n")
        sys.stdout.write(tally.text())
    return int(bool(tally.findings))


def _run(kind: str, left: int, number: int, tally: Tally) -> None:
    """So many cases of a kind, a piece of them in each process."""
    each = pieces(kind, tally.folder)
    while left > 0:
        before, count = sum(tally.codes[kind].values()), min(left, PIECE)
        whole = in_a_process(kind, partial(each, count, number), tally.told)
        left -= count if whole else max(1, sum(tally.codes[kind].values()) - before)
        number += 1000


if __name__ == "__main__":
    sys.exit(main())
