"""Options of the benchmarks, the signals and models they share, and the table they end in."""

import os
from pathlib import Path

import numpy as np
import pytest
from ratios import Row, Table, Work, side_by_side

from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel

TABLE = pytest.StashKey[Table]()
SAMPLE_TIME_S = 5e-5


def pytest_addoption(parser):
    group = parser.getgroup("hammerstein benchmarks")
    short = os.environ.get("HAMMERSTEIN_BENCH") == "short"
    group.addoption("--short", action="store_true", default=short, help="shorter signals, under a minute")
    root = Path(__file__).resolve().parents[2]
    folder = os.environ.get("HAMMERSTEIN_BENCH_OUT", str(root / "reports" / "benchmarks"))
    group.addoption("--table", metavar="DIR", default=folder, help="where the table is written")


def pytest_configure(config):
    config.stash[TABLE] = Table(config.getoption("--short"))


def pytest_terminal_summary(terminalreporter, config):
    table = config.stash[TABLE]
    if table.rows:
        folder = Path(config.getoption("--table"))
        table.write(folder)
        terminalreporter.section("benchmarks")
        for line in table.lines():
            terminalreporter.write_line(line)
        terminalreporter.write_line(f"written to {folder / 'benchmarks.md'} and benchmarks.json")


class Bench:
    """What a benchmark measures with: sizes for the chosen form, and rows for the table."""

    def __init__(self, table, short):
        self.table, self.short = table, short
        self.samples = 100_000 if short else 1_000_000
        self.repeats = 7 if short else 11

    def compare(self, group, what, against, ours: Work, other: Work, sense="", required=None, repeats=None):
        """Row with the ratio other / ours; for ``<=`` the ratio ours / other."""
        a, b, ratio = side_by_side(ours, other, repeats or self.repeats)
        if sense == "<=":
            ratio = 1.0 / ratio
        row = self.table.add(Row(group, what, against, a, b, "ns", ratio, sense, required))
        assert row.acceptable, f"{what} against {against}: {ratio:.3g}, required {sense} {required}"

    def fewer(self, samples):
        """Give a number of samples, a tenth of it in the short form."""
        return samples // 10 if self.short else samples


@pytest.fixture
def bench(pytestconfig):
    table = pytestconfig.stash[TABLE]
    return Bench(table, table.short)


@pytest.fixture(scope="session")
def published():
    """The static block of the published actuator, 2 x 2 with 15 operators."""
    return HammersteinModel.load("duo_bimorph_static")


def with_operators(n, axes=2):
    """A model of n operators a pair: the published one at 15, else an even grid and positive weights."""
    if n == 15 and axes == 2:
        return HammersteinModel.load("duo_bimorph_static").hysteresis
    r, rng = np.linspace(0.07, 9.7, n), np.random.default_rng(n)
    rows = [[Pair(r, rng.uniform(0.0, 12.0 / n, n)) for _ in range(axes)] for _ in range(axes)]
    return PrandtlIshlinskii(rows)


def sines(samples, axes=2):
    """50 Hz, 10 V, each axis with its own phase (axis, sample)."""
    t = np.arange(samples) * SAMPLE_TIME_S
    return 10.0 * np.sin(2 * np.pi * 50.0 * t + np.arange(axes)[:, None])


def noise(samples, axes=2):
    """White noise: two samples of three are a reversal."""
    return np.random.default_rng(1).uniform(-10.0, 10.0, (axes, samples))
