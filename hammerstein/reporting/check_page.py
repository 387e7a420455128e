"""Page of a check: findings, and old and new curves."""

from collections.abc import Iterator

from hammerstein.escaping import Markdown
from hammerstein.regression.compare import Kind
from hammerstein.regression.result import TITLE, CheckResult, ScenarioCheck
from hammerstein.reporting.page import Page, Shown
from hammerstein.runtime.staging import Owner

CHECK_PAGE = Owner("check page", single=True)
FIRST_SHOWN = ("rms_um", "gain", "height_um", "max_um", "value")
MOST_METRICS = 2
"""Most figures of merit that are drawn for a scenario; the table has all."""
MOST_FIGURES = 30
"""Most figures of one page; more load too slowly."""

MOST_CHANGED = "At most three rows are drawn, those that changed most."
NOT_DRAWN = "There is no figure: this run has no number of the baseline."
TOO_MANY = f"There is no figure: the page has {MOST_FIGURES}, those of other scenarios."


def check_page(result: CheckResult) -> str:
    """HTML page of a check; equal results give equal bytes."""
    from hammerstein.reporting.figures.moved import courses_of, moved_figure
    from hammerstein.reporting.figures.write import svg_of

    wanted = [(check, metric) for check in result.checks for metric in _metrics(check)]
    # those that fail first: a page holds only so many
    wanted = sorted(wanted, key=lambda item: item[0].passed)[:MOST_FIGURES]
    drawn: dict[str, bytes] = {}
    shown: dict[str, list[Markdown]] = {check.name: [] for check in result.checks}
    for number, (check, metric) in enumerate(wanted):
        courses = courses_of(metric, check.accepted, check.now, check.tolerances)
        drawn[f"{number}.svg"] = svg_of(moved_figure(courses, metric))
        title = f"{check.name}: {metric}, baseline and now"
        shown[check.name].append(Shown(f"{number}", title, MOST_CHANGED).markdown())
    for check in result.checks:
        if check.accepted and not check.passed and not shown[check.name]:
            shown[check.name].append(Markdown(TOO_MANY if any(_metrics(check)) else NOT_DRAWN))
    failed = sum(not check.passed for check in result.checks)
    return Page(
        heading=Markdown(TITLE),
        what=f"Check against {result.baseline_folder}",
        title=f"Scenarios that differ from their baseline: {failed} of {len(result.checks)}",
        answer=Markdown(),
        body=result.body({name: Markdown("\n\n").join(figures) for name, figures in shown.items()}),
    ).html(drawn)


def _metrics(check: ScenarioCheck) -> Iterator[str]:
    """Numbers that are drawn: those that moved most, otherwise the first that the scenario has."""
    if not check.accepted:
        return
    moved = [finding for finding in check.findings if finding.kind is Kind.MOVED]
    moved.sort(key=lambda finding: -finding.excess)
    names = list(dict.fromkeys(finding.metric for finding in moved))[:MOST_METRICS]
    both = {name for key, old in check.accepted.items() for name in old if name in check.now.get(key, {})}
    yield from names or [name for name in (*FIRST_SHOWN, *sorted(both)) if name in both][:1]
