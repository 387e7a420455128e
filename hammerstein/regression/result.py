"""Result of a check, for the terminal, a summary page and CI."""

import math
import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any
from xml.etree import ElementTree

from hammerstein.errors import HammersteinError, InputError, Mistake, ToleranceError
from hammerstein.escaping import Markdown, clean
from hammerstein.experiment.report import Report
from hammerstein.experiment.run import Outcome, find_scenarios, load_all, run_all
from hammerstein.experiment.set_up import Progress
from hammerstein.metrics import KEY
from hammerstein.quantities import number_of
from hammerstein.regression.compare import (
    Baseline,
    Finding,
    Kind,
    Numbers,
    compare,
    deviation,
    limit,
    new_columns,
    numbers_of,
)
from hammerstein.runtime.parallel_tasks import Jobs
from hammerstein.runtime.staging import Owner
from hammerstein.scenario import scenario_of
from hammerstein.scenario.scenario import ScenarioSource, Tolerance

DEFAULT_FOLDER = Path("reports/baseline")
SUITE, TITLE = "hammerstein check", "# Scenarios and their baselines"
JUNIT, SUMMARY = Owner("check junit", single=True), Owner("check summary", single=True)
SHOWN = 20  # lines of a table; who has moved more than that wants the worst, not all
MISSING = "missing"
_AXES = ("excited_axis", "measured_axis")  # shown as one column
_COLUMNS = (
    *("claim", "actuator", *(name for name in KEY if name not in _AXES)),
    *("axis", "metric", "baseline", "now", "change", "allowed"),
)


@dataclass(frozen=True)
class ScenarioCheck:
    """Result of checking one scenario.

    path : scenario file; for an orphan its baseline file
    numbers : how many numbers were compared
    findings : differences
    new_columns : numbers that no row of the baseline has; they are not compared yet
    error : error that stopped the run
    written : with an update, whether the baseline had to be written; otherwise None
    kept : with an update, the new name of a baseline that a person had changed
    accepted, now : numbers of the baseline, empty if nothing was compared, and of this run
    tolerances : by name of the number, where the scenario gives its own
    """

    name: str
    path: Path
    numbers: int = 0
    findings: tuple[Finding, ...] = ()
    new_columns: tuple[str, ...] = ()
    error: HammersteinError | None = None
    written: bool | None = None
    kept: Path | None = None
    accepted: Numbers = field(default_factory=dict)
    now: Numbers = field(default_factory=dict)
    tolerances: Mapping[str, Tolerance] = field(default_factory=dict)

    @property
    def headline(self) -> str:
        """One line: what was found."""
        if self.error is not None:
            return f"{self.name}: could not be checked"
        if self.written is not None:
            aside = f"; your edited file is now {self.kept}" if self.kept else ""
            word = "written" if self.written else "unchanged"
            return f"{self.name}: baseline {word}, {number_of(self.numbers, 'number')}{aside}"
        found = ", ".join(_counts(self.findings, self.numbers))
        return f"{self.name}: {found or number_of(self.numbers, 'number') + ' within tolerance'}"

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return self.error is None and not self.findings

    def lines(self, baseline_folder: Path) -> list[str]:
        """Headline, table of differences, and remedy."""
        rows, below = self.details(baseline_folder)
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        table = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        return [self.headline, *(f"  {line}" for line in table), *below]

    def details(self, baseline_folder: Path) -> tuple[list[list[str]], list[str]]:
        """Rows of the table of differences, its head first, and the lines below it."""
        if self.error is not None:
            return [], [f"  {line}" for line in str(self.error).splitlines()]
        if not self.findings:
            return [], self._notes()
        if any(finding.kind is Kind.ORPHAN for finding in self.findings):
            return [], [f"  delete {self.path}, or restore its scenario"]
        rows, more = _table(self.findings)
        if any(finding.kind is Kind.NO_BASELINE for finding in self.findings):
            more.append(f"  looked for {baseline_folder / f'{self.name}.json'}")
        return rows, [*more, *_moved_keys(self.findings), *self._notes(), self._remedy(baseline_folder)]

    def _notes(self) -> list[str]:
        if not self.new_columns:
            return []
        names, them = ", ".join(self.new_columns), "it" if len(self.new_columns) == 1 else "them"
        return [f"  note: new in the report: {names}; --update-baseline accepts {them}"]

    def _remedy(self, baseline_folder: Path) -> str:
        words = ["hammerstein", "check", str(self.path)]
        if baseline_folder != DEFAULT_FOLDER:
            words += ["--baseline", str(baseline_folder)]
        return f"If you intended this change: {shlex.join([*words, '--update-baseline'])}"


@dataclass(frozen=True)
class CheckResult:
    """What a check of scenario files found."""

    checks: tuple[ScenarioCheck, ...]
    baseline_folder: Path = DEFAULT_FOLDER

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything that differs, over all scenarios."""
        return tuple(finding for check in self.checks for finding in check.findings)

    @property
    def exit_code(self) -> int:
        """0: all within tolerance; 1: findings; the code of the gravest error if a run was stopped."""
        errors = [check.error.exit_code for check in self.checks if check.error is not None]
        return max([*errors, ToleranceError.exit_code if self.findings else 0])

    def text(self) -> str:
        """Return the whole result for a person."""
        return "\n".join(line for check in self.checks for line in check.lines(self.baseline_folder))

    def as_dict(self) -> dict[str, Any]:
        """Return the whole result as plain JSON."""
        return {"exit_code": self.exit_code, "scenarios": [_as_dict(check) for check in self.checks]}

    def markdown(self) -> str:
        """Return a summary page: one line a scenario, then what differs."""
        return Markdown("\n\n").join([Markdown(TITLE), self.body()]) + "\n"

    def body(self, figures: Mapping[str, Markdown] = MappingProxyType({})) -> Markdown:
        """Summary without its title.

        figures : of a scenario by its name, below what differs
        """
        lines = [Markdown("| scenario | result |"), Markdown("|---|---|")]
        for check in self.checks:
            found = check.headline.removeprefix(f"{check.name}: ")
            mark = Markdown("pass" if check.passed else "**FAIL**")
            note = "; new: " + ", ".join(check.new_columns) if check.new_columns else ""
            lines.append(Markdown("| {} | {}: {} |").format(check.name, mark, found + note))
        parts = [Markdown("\n").join(lines)]
        for check in sorted(self.checks, key=lambda check: check.passed):
            shown = [figures[check.name]] if figures.get(check.name) else []
            if not check.passed:
                rows, below = check.details(self.baseline_folder)
                ticks = (len(run) for line in below for run in re.findall("`+", line))
                fence = Markdown("`" * (1 + max([2, *ticks])))
                text = [Markdown(clean(line.strip())) for line in below]
                shown.insert(0, Markdown("\n").join([fence + Markdown("text"), *text, fence]))
                at = rows[0].index("metric") if rows else 0  # a long name, which stands with the first column
                short = [[f"{row[0]}, {row[at]}", *row[1:at], *row[at + 1 :]] for row in rows]
                table = [Markdown("| {} |").format(Markdown(" | ").join(row)) for row in short]
                rule = Markdown("|") + Markdown(" --- |") * len(short[0]) if rows else Markdown()
                shown.insert(0, Markdown("\n").join([*table[:1], rule, *table[1:]]))
            if shown:
                parts += [Markdown("## {}").format(check.name), *shown]
        return Markdown("\n\n").join(parts)

    def junit(self) -> str:
        """Return a JUnit XML file: one test case a scenario, without times so that two runs are equal."""
        failures = sum(not check.passed and check.error is None for check in self.checks)
        errors = sum(check.error is not None for check in self.checks)
        counts = {"tests": str(len(self.checks)), "failures": str(failures), "errors": str(errors)}
        root = ElementTree.Element("testsuites", counts)
        suite = ElementTree.SubElement(root, "testsuite", {"name": SUITE, **counts})
        for check in self.checks:
            names = {"classname": check.path.parent.as_posix(), "name": check.name}
            case = ElementTree.SubElement(suite, "testcase", {k: clean(v) for k, v in names.items()})
            if not check.passed:
                tag = "failure" if check.error is None else "error"
                problem = ElementTree.SubElement(case, tag, {"message": clean(check.headline)})
                problem.text = clean("\n".join(check.lines(self.baseline_folder)))
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _counts(findings: Sequence[Finding], numbers: int) -> Iterable[str]:
    """Short statements, one for each kind of finding."""
    kinds = [finding.kind for finding in findings]
    if lost := [finding.metric for finding in findings if finding.kind is Kind.MISSING_COLUMN]:
        yield f"{', '.join(lost)} {'is' if len(lost) == 1 else 'are'} missing from every row"
    for kind in (Kind.NO_BASELINE, Kind.ORPHAN, Kind.SCENARIO_CHANGED, Kind.MODEL_CHANGED):
        if kind in kinds:
            yield str(kind)
    moved = kinds.count(Kind.MOVED)
    if moved:
        yield f"{moved} of {number_of(numbers, 'number')} left {'its' if moved == 1 else 'their'} tolerance"
    for kind, what, state in (
        (Kind.MISSING_ROW, "row", "missing"),
        (Kind.MISSING_NUMBER, "number", "missing"),
        (Kind.EXTRA_ROW, "row", "not in the baseline"),
        (Kind.EXTRA_NUMBER, "number", "not in the baseline"),
    ):
        if kind in kinds:
            count = kinds.count(kind)
            yield f"{number_of(count, what)} {'is' if count == 1 else 'are'} {state}"


def _moved_keys(findings: Sequence[Finding]) -> Iterator[str]:
    """Column by which no row of the baseline is like one of now: these runs cannot be compared."""
    old, new = (
        [dict(f.key) for f in findings if f.kind is kind] for kind in (Kind.MISSING_ROW, Kind.EXTRA_ROW)
    )
    for name in dict.fromkeys(name for row in old for name in row) if new else ():
        before, now = ({row.get(name): None for row in rows} for rows in (old, new))
        if not before.keys() & now.keys():
            were, are = (", ".join(map(str, values)) for values in (before, now))
            yield f"  rows of another {name} are not compared: {were} in the baseline, {are} now"


def _table(findings: Sequence[Finding]) -> tuple[list[list[str]], list[str]]:
    """Rows of a table, its head first, then the worst findings; and how many are left out."""
    inside = sorted((f for f in findings if f.key), key=lambda finding: -finding.excess)
    rows = [_cells(finding) for finding in inside[:SHOWN]]
    columns = [column for column in _COLUMNS if any(row.get(column) for row in rows)]
    more = [f"  the {SHOWN} worst are listed; {len(inside) - SHOWN} more"] * (len(inside) > SHOWN)
    return [columns] * bool(rows) + [[row.get(c, "") for c in columns] for row in rows], more


def _cells(finding: Finding) -> dict[str, str]:
    """Cells of one finding by column."""
    cells = {name: _plain(value) for name, value in finding.key}
    excited, measured = (cells.pop(name, "") for name in _AXES)
    cells["axis"] = measured if excited in ("all", measured) else f"{excited} -> {measured}"
    cells |= {"metric": finding.metric or "(row)", "change": "", "allowed": ""}
    before, now = finding.baseline, finding.now
    if isinstance(before, (int, float)) and isinstance(now, (int, float)):
        cells["baseline"], cells["now"] = _distinct(before, now)
        moved, tolerance = deviation(finding.metric, now, before), finding.tolerance
        relative = limit(before, tolerance) > tolerance.absolute  # else the absolute bound is the larger one
        cells["change"] = f"{_rounded(100.0 * moved / abs(before), 2)} %" if relative else _rounded(moved, 3)
        cells["allowed"] = f"{100.0 * tolerance.relative:g} %" if relative else f"{tolerance.absolute:g}"
        return cells
    stored = finding.kind in (Kind.MISSING_ROW, Kind.MISSING_NUMBER)
    cells["baseline"] = _plain(before) if before is not None else "present" if stored else MISSING
    cells["now"] = _plain(now) if now is not None else MISSING if stored else "present"
    return cells


def _rounded(change: float, digits: int) -> str:
    """Change with its sign; a large one has no exponent.

    >>> _rounded(287.3, 2), _rounded(-0.01234, 3)
    ('+290', '-0.0123')
    """
    return f"{float(f'{change:.{digits}g}'):+.15g}"


def _plain(value: float | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _distinct(before: float, now: float) -> tuple[str, str]:
    """Both numbers, with as many digits as tell them apart."""
    for digits in range(4, 17):
        pair = f"{before:.{digits}g}", f"{now:.{digits}g}"
        if pair[0] != pair[1]:
            return pair
    return repr(before), repr(now)


def _as_dict(check: ScenarioCheck) -> dict[str, Any]:
    return {
        "name": check.name,
        "passed": check.passed,
        "numbers": check.numbers,
        "error": None if check.error is None else str(check.error),
        "baseline_written": bool(check.written),
        "new_columns": list(check.new_columns),
        "findings": [
            {
                "kind": finding.kind.name.lower(),
                "row": dict(finding.key) or None,
                "metric": finding.metric or None,
                "baseline": _json(finding.baseline),
                "now": _json(finding.now),
            }
            for finding in check.findings
        ],
    }


def _json(value: float | str | None) -> float | str | None:
    """Value that JSON can hold: NaN and infinity as words."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def check_files(
    paths: Sequence[Path],
    baseline_folder: Path = DEFAULT_FOLDER,
    update: bool = False,
    jobs: Jobs = 1,
    progress: Progress | None = None,
    finished: Callable[[str], None] | None = None,
    overwrite: bool = False,
) -> CheckResult:
    """Run scenario files and compare each with ``<baseline_folder>/<scenario>.json``.

    A scenario without a baseline is a finding, and so is a baseline without a scenario if a whole folder is
    checked. A scenario that cannot be run does not stop the others.

    Parameters
    ----------
    paths : scenario files, or folders of them
    baseline_folder : where the baselines are
    update : write the baselines instead of comparing them; otherwise nothing is written
    jobs : number of parallel scenarios, or an executor for their cases; the numbers do not depend on it
    progress : called with the current step, the amount done, and the total
    finished : called with the name of each finished scenario
    overwrite : whether an update replaces baselines that a person changed; otherwise they are kept aside

    Raises
    ------
    InputError : a scenario file is wrong; every file is read before the first is run
    """
    scenarios = load_all(paths)
    files = {path.stem: path for path in find_scenarios(paths)}
    checks = {}
    for outcome in run_all(scenarios, _keep, jobs, progress):
        baseline = baseline_folder / f"{outcome.name}.json"
        checks[outcome.name] = _checked(outcome, files[outcome.name], baseline, update, overwrite)
        if finished is not None:
            finished(outcome.name)
    ordered = [checks[name] for name in files]
    return CheckResult((*ordered, *_orphans(paths, set(files), baseline_folder)), baseline_folder)


def check(
    scenario: ScenarioSource,
    baseline: str | Path | None = None,
    update: bool = False,
    jobs: Jobs = 1,
    progress: Progress | None = None,
) -> CheckResult:
    """Run one scenario, or every scenario of a folder, and compare the numbers with the accepted ones.

    Parameters
    ----------
    scenario : a scenario, its file, a folder of files, or a mapping with what a file would hold
    baseline : folder of the baselines; for a scenario without a file, the file of its baseline
    update : write the baselines instead of comparing them; otherwise nothing is written
    jobs, progress : as for ``check_files``

    Raises
    ------
    InputError : a scenario is wrong, or a scenario without a file has no file of its baseline
    """
    if isinstance(scenario, str | Path):
        folder = DEFAULT_FOLDER if baseline is None else Path(baseline)
        return check_files([Path(scenario)], folder, update, jobs, progress)
    if baseline is None:
        raise InputError("check", "a scenario without a file has no name: give the file of its baseline")
    file, validated = Path(baseline), scenario_of(scenario)[1]
    (outcome,) = run_all({file.stem: validated}, _keep, jobs, progress)
    return CheckResult((_checked(outcome, Path(file.stem), file, update),), file.parent)


def _keep(report: Report) -> tuple[Path, ...]:
    """Do nothing with a report but hand it back: a check writes no report."""
    return ()


def _checked(
    outcome: Outcome, path: Path, baseline: Path, update: bool, overwrite: bool = False
) -> ScenarioCheck:
    if outcome.report is None:
        return ScenarioCheck(outcome.name, path, error=outcome.error)
    try:
        report = outcome.report
        saved = Baseline.of(report).save(baseline, overwrite) if update else None
        found = _compare(report, baseline) if saved is None else saved._asdict()
        now = numbers_of(report)
    except HammersteinError as error:
        return ScenarioCheck(outcome.name, path, error=error)
    return ScenarioCheck(outcome.name, path, sum(map(len, now.values())), now=now, **found)


def _compare(report: Report, baseline: Path) -> dict[str, Any]:
    """Differences from the baseline, and tolerances."""
    if not baseline.is_file():
        return {"findings": (Finding(Kind.NO_BASELINE),)}
    accepted, tolerances = _load(baseline), report.scenario.tolerances
    return {
        "findings": compare(report, accepted, tolerances),
        "new_columns": new_columns(report, accepted),
        "accepted": accepted.rows,
        "tolerances": tolerances,
    }


def _load(path: Path) -> Baseline:
    try:
        return Baseline.load(path)
    except InputError as error:
        advice = Mistake("", "restore the file, or write a new one with --update-baseline")
        raise InputError(str(path), [*error.mistakes, advice]) from None


def _orphans(paths: Sequence[Path], names: set[str], baseline_folder: Path) -> list[ScenarioCheck]:
    """Baselines without a scenario; of single files nobody can tell."""
    if not any(path.is_dir() for path in paths):
        return []
    return [
        ScenarioCheck(file.stem, file, findings=(Finding(Kind.ORPHAN),))
        for file in sorted(baseline_folder.glob("*.json"))
        if file.stem not in names
    ]
