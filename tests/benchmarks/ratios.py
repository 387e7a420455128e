"""Times measured side by side, and the table of their ratios."""

from __future__ import annotations

import gc
import json
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path

MARGIN = 0.3  # a required ratio may be missed by this part before a benchmark fails: machines are noisy


@dataclass(frozen=True)
class Work:
    """Something to time, and how many samples it works through."""

    call: Callable[[], object]
    samples: int


@dataclass(frozen=True)
class Row:
    """One ratio. ``required`` is at least (``">="``) or at most (``"<="``) what the ratio must be."""

    group: str
    what: str
    against: str
    ours: float
    other: float
    unit: str
    ratio: float
    sense: str = ""
    required: float | None = None

    @property
    def verdict(self) -> str:
        """Whether the requirement is reached; empty if there is none."""
        if self.required is None:
            return ""
        more = self.sense == ">="
        return "reached" if (self.ratio >= self.required) == more or self.ratio == self.required else "MISSED"

    @property
    def acceptable(self) -> bool:
        """Whether the requirement is reached or missed by no more than the margin."""
        if self.required is None:
            return True
        if self.sense == ">=":
            return self.ratio >= self.required * (1 - MARGIN)
        return self.ratio <= self.required * (1 + MARGIN)


def side_by_side(ours: Work, other: Work, repeats: int) -> tuple[float, float, float]:
    """Median ns a sample of both, and the median of ``other / ours``, each pair timed one after the other."""
    ours.call(), other.call()
    pairs = []
    gc.disable()
    try:
        for i in range(repeats):
            # Whoever comes second may find warmer caches: take turns.
            works = (ours, other) if i % 2 else (other, ours)
            times = {id(work): _ns_a_sample(work) for work in works}
            pairs.append((times[id(ours)], times[id(other)]))
    finally:
        gc.enable()
    a, b = zip(*pairs, strict=True)
    return statistics.median(a), statistics.median(b), statistics.median(y / x for x, y in pairs)


def _ns_a_sample(work: Work) -> float:
    """Time of the processor, not of the wall: what else the machine does meanwhile is not counted."""
    start = time.process_time_ns()
    work.call()
    return (time.process_time_ns() - start) / work.samples


def quickest(works: dict[str, Work]) -> tuple[str, Work]:
    """Of several ways to do the same work, the one that takes the least time on this machine."""
    for work in works.values():
        work.call()
    times = {name: min(_ns_a_sample(work) for _ in range(3)) for name, work in works.items()}
    best = min(times, key=times.__getitem__)
    return best, works[best]


class Table:
    """Rows in the order in which they were measured."""

    def __init__(self, short: bool):
        self.short = short
        self.machine = machine()
        self.rows: list[Row] = []

    def add(self, row: Row) -> Row:
        """Keep a row and give it back."""
        self.rows.append(row)
        return row

    def lines(self) -> list[str]:
        """Markdown of the whole table."""
        head = ["what", "against", "ours", "other", "ratio", "required", ""]
        lines = [*self._header(), ""]
        for group in dict.fromkeys(row.group for row in self.rows):
            cells = [head] + [_cells(row) for row in self.rows if row.group == group]
            widths = [max(len(row[i]) for row in cells) for i in range(len(head))]
            ruled = [cells[0], ["-" * width for width in widths], *cells[1:]]
            lines += [f"**{group}**", ""]
            lines += [
                "| " + " | ".join(c.ljust(w) for c, w in zip(r, widths, strict=True)) + " |" for r in ruled
            ]
            lines.append("")
        return lines

    def _header(self) -> list[str]:
        facts = [f"{key}: {value}" for key, value in self.machine.items()]
        form = "short form" if self.short else "full form"
        return [
            f"Benchmarks, {form}, {date.today().isoformat()}. Command: `{self.command()}`",
            "",
            "; ".join(facts),
            "",
            "Times are medians of processor time a sample; a ratio is the median of ratios of times measured "
            "one after the other in one process.",
        ]

    def command(self) -> str:
        """Give the command that makes this table."""
        paths = " ".join(argument for argument in sys.argv[1:] if argument.startswith("tests"))
        return f"python -m pytest -n 0 {paths or 'tests/benchmarks'}" + (" --short" if self.short else "")

    def write(self, folder: Path) -> None:
        """Write ``benchmarks.md`` and ``benchmarks.json``."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "benchmarks.md").write_text("\n".join(self.lines()) + "\n", encoding="utf-8")
        rows = [asdict(row) | {"verdict": row.verdict} for row in self.rows]
        about = {"date": date.today().isoformat(), "command": self.command(), "machine": self.machine}
        text = json.dumps(about | {"rows": rows}, indent=1, sort_keys=True)
        (folder / "benchmarks.json").write_text(text + "\n", encoding="utf-8")


def _cells(row: Row) -> list[str]:
    required = "" if row.required is None else f"{row.sense} {row.required:g}"
    ours, other = (f"{_digits(value)} {row.unit}" for value in (row.ours, row.other))
    return [row.what, row.against, ours, other, _digits(row.ratio), required, row.verdict]


def _digits(value: float) -> str:
    """Three digits, never an exponent."""
    return f"{float(f'{value:.3g}'):,.0f}" if value >= 100 else f"{value:.3g}"


def machine() -> dict[str, str]:
    """Processor, its number of cores, how many processes want them, and the versions that matter."""
    names = [line.split(":")[1].strip() for line in _cpu_lines() if line.startswith("model name")]
    about = {"processor": names[0] if names else platform.processor() or platform.machine()}
    about |= {"cores": str(os.cpu_count()), "python": platform.python_version()}
    about |= {"load": f"{os.getloadavg()[0]:.1f}"} if hasattr(os, "getloadavg") else {}
    return about | {name: version(name) for name in ("numpy", "numba", "control")}


def _cpu_lines() -> list[str]:
    path = Path("/proc/cpuinfo")
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []
