"""The command that runs a scenario with many values of its keys."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import os
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, BinaryIO

import typer

from hammerstein.commands.jobs import PROCESSORS, Address, Jobs, Yes, announce, process_pool, workers
from hammerstein.commands.options import Overwrite, refuse_output, with_help, write_output
from hammerstein.commands.scenarios import one_scenario
from hammerstein.commands.terminal import Watch, complain, tell
from hammerstein.errors import InputError
from hammerstein.escaping import cell
from hammerstein.files import reason_of
from hammerstein.runtime.resources import cache_folder

if TYPE_CHECKING:
    from hammerstein.experiment.study import Sampled
    from hammerstein.scenario import Scenario

PARQUET = (".parquet", ".pq")
LINES_AT_ONCE = 1000  # of a Parquet file


def sweep(
    path: Annotated[Path, typer.Argument(help="Scenario file with a table [study].")],
    out: Path | None = with_help("File for the rows, .csv or .parquet.", metavar="FILE"),
    jobs: Jobs = PROCESSORS,
    cluster: Address = None,
    fresh: bool = with_help("Ignore results of earlier runs.", default=False),
    overwrite: Overwrite = False,
    dry_run: bool = with_help("Print the number of runs and the time; run nothing.", default=False),
    yes: Yes = False,
) -> None:
    """Run a scenario for many values of its keys.

    The values are lists or samples, and one table has all rows. They are written as soon as they are
    computed, so memory does not grow with their number. Results are cached, and an interrupted sweep
    continues where it stopped.
    """
    from hammerstein.experiment.study import sampled, study_of
    from hammerstein.runtime import store as kept_results
    from hammerstein.runtime.parallel_tasks import workers_of

    table_file = _place_of(out, overwrite, dry_run)
    _, scenario = one_scenario(path)
    study = study_of(scenario, str(path))
    if table_file is None:
        complain(_announced(scenario, path, jobs)[0])
        return
    store, useless = kept_results.opened(fresh)
    if useless:
        complain(useless)
    failed = 0
    with workers(jobs, cluster) as asked, _written(table_file, overwrite) as table:
        told, seconds = _announced(scenario, path, workers_of(asked))
        announce(told, seconds, yes)
        if store is not None:
            store = store.computed(getattr(asked, "elsewhere", ""))
        with process_pool(asked, workers_of(asked) * seconds) as crew, Watch(1) as watch:
            for one in sampled(scenario, str(path), crew, watch.progress, store):
                failed += bool(one.error)
                table.add(one)
    if store is not None and store.problem:
        complain(store.problem)
    if failed:
        complain(f"{failed} of {study.count()} runs failed; see the column error")
    tell(f"{study.count()} runs written in {table_file}")


def _place_of(out: Path | None, overwrite: bool, dry_run: bool) -> Path | None:
    """Where the rows go: a place that can be written to; None where nothing is written."""
    from hammerstein.runtime.staging import SWEEP

    if dry_run:
        return None
    if out is None:
        raise InputError("--out", "is missing; give a file for the rows, .csv or .parquet")
    refuse_output(out, [], SWEEP, overwrite)
    return out


def _announced(scenario: Scenario, path: Path, jobs: int) -> tuple[str, float]:
    """How many runs there are and how long they take, in words and in seconds."""
    from hammerstein.experiment.study import plan_of_study
    from hammerstein.quantities import duration, size

    (part,) = plan_of_study(scenario, str(path)).parts
    seconds = part.seconds / jobs
    side = f" with {jobs} jobs" if jobs > 1 else ""
    return f"{part.what}, about {duration(seconds)}{side}, {size(jobs * part.bytes)} of memory", seconds


@contextlib.contextmanager
def _written(out: Path, overwrite: bool) -> Iterator[_Csv | _Parquet]:
    """A table that takes its name when it is whole; until then its file has none, and ends with the process.

    Raises InputError where another sweep is writing it.
    """
    from hammerstein.runtime.staging import SWEEP

    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with _alone(out), tempfile.TemporaryFile(dir=out.parent) as file:
            table = _Parquet(file) if out.suffix in PARQUET else _Csv(file)
            with contextlib.closing(table):
                yield table
            file.seek(0)
            write_output(out, file, SWEEP, overwrite)
    except OSError as error:
        what = f"cannot be written ({reason_of(error)}); choose another place"
        raise InputError(str(out), what) from None


@contextlib.contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Let no other sweep of this user write the same file; InputError where one does.

    The lock lies in the user's cache folder, where a killed sweep leaves nothing beside the file. Where there
    is no such folder, the one that ends last has its rows in the file.
    """
    from hammerstein.runtime.staging import locked

    with contextlib.ExitStack() as held:
        if (place := cache_folder()) is not None:
            name = hashlib.sha256(os.fsencode(out.resolve())).hexdigest()
            with contextlib.suppress(OSError):
                (place / "locks").mkdir(mode=0o700, parents=True, exist_ok=True)
                held.enter_context(
                    locked(place / "locks" / name, 0.0, ("--out", f"another sweep is writing {out}"))
                )
        yield


def _lines(one: Sampled) -> Iterator[dict[str, Any]]:
    """One line a row, with the values of its run; a run without rows has one line."""
    from hammerstein.metrics import KEY, metrics_of

    run: Mapping[str, Any] = {"sample": one.number, **{key: float(v) for key, v in one.point.items()}}
    names = [metric.name for metric in metrics_of()]
    none = dict.fromkeys((*KEY, *names))
    for columns in [row.columns() for row in one.rows] or [none]:
        figures = {name: None if columns[name] is None else float(columns[name]) for name in names}
        yield {**run, **{name: columns[name] for name in KEY}, **figures, "error": one.error}


class _Csv:
    def __init__(self, file: BinaryIO) -> None:
        self._file = io.TextIOWrapper(file, newline="", encoding="utf-8")
        self._writer: Any = None

    def add(self, one: Sampled) -> None:

        for line in _lines(one):
            if self._writer is None:
                self._writer = csv.DictWriter(self._file, list(line), lineterminator="\n")
                self._writer.writeheader()
            self._writer.writerow({k: cell(v) if isinstance(v, str) else v for k, v in line.items()})

    def close(self) -> None:
        self._file.detach()  # what is left is written; the file itself stays open


class _Parquet:
    def __init__(self, file: BinaryIO) -> None:

        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            what = "Parquet needs pyarrow: pip install 'hammerstein-control[parquet]', or write .csv"
            raise InputError("--out", what) from None
        self._arrow, self._parquet, self._file = pyarrow, parquet, file
        self._lines: list[dict[str, Any]] = []
        self._writer: Any = None

    def add(self, one: Sampled) -> None:
        self._lines += _lines(one)
        if len(self._lines) >= LINES_AT_ONCE:
            self._flush()

    def _flush(self) -> None:
        if not self._lines:
            return
        texts = {"compensator", "excited_axis", "measured_axis", "error"}
        arrow = self._arrow
        types = {"sample": arrow.int64()} | dict.fromkeys(texts, arrow.string())
        schema = arrow.schema([(name, types.get(name, arrow.float64())) for name in self._lines[0]])
        if self._writer is None:
            self._writer = self._parquet.ParquetWriter(self._file, schema)
        self._writer.write_table(arrow.Table.from_pylist(self._lines, schema))
        self._lines = []

    def close(self) -> None:
        self._flush()
        if self._writer is not None:
            self._writer.close()
