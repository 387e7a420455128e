"""Page of a run: question, answer, figures, numbers, and settings."""

import inspect
import math
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import PurePath
from typing import Any

from hammerstein.escaping import Markdown, code, markdown, markdown_page
from hammerstein.experiment.report import Report, Trace
from hammerstein.metrics import METRICS
from hammerstein.model import HammersteinModel
from hammerstein.quantities import number_of, percent
from hammerstein.reporting.figures.choice import MOST_OVERLAYS
from hammerstein.reporting.figures.path import is_sparse
from hammerstein.reporting.page import Judged, NumberFile, Page, Shown, figures_section, paragraphs
from hammerstein.reporting.summary import sentences, span
from hammerstein.reporting.tables import number_tables
from hammerstein.scenario.source import ModelSource

# What a figure is and how to read it, by the first words of its file name; longer ones first. The order is
# that of the page: what is compared first, then its errors, the true position before the reading.
TITLES = {
    "drift": "Drift",
    "loops": "Loops",
    "path": "Path",
    "operators": "Error against the number of operators",
    "trials_true": "Error of the true position against trial",
    "trials": "Error of the sensor's reading against trial",
    "sweep_true": "Error of the true position against frequency",
    "sweep": "Error of the sensor's reading against frequency",
    "errors": "Errors over time",
    "sensitivity": "Causes of the spread",
}
CAPTIONS = {
    "sensitivity": "Shares of the variance over the random actuators, for each compensator, at the condition "
    "with the highest 95th percentile. Dark: the parameter alone. Pale: with its interactions. Thin: 95 % "
    "limits. Correlated errors of the weights of one axis count as one parameter.",
    "sweep_true": "One panel for each transfer, or several where there are more than four compensators.",
    "sweep": "One panel for each transfer, or several where there are more than four curves.",
    "trials_true": "One panel for each measured axis. Trial 1 is without learning; each later trial corrects "
    "the voltages with the sensor readings of the previous one, until only noise remains.",
    "trials": "One panel for each measured axis.",
    "operators": "Rms error of models that differ only in their number of play operators.",
    "loops": "One row of panels for each measured axis, one column for each driven axis. Each curve is the "
    "mean of the measured cycles.",
    "errors": "The legend gives the worst error of all measured cycles.",
    "drift": "Mean error of the true position over each measured cycle, for the driven axis.",
    "path": "The legend gives the worst distance of all cycles.",
}

IS_TRUE = '"True" is the actuator\'s position, without the sensor.'
NOT_PREDICTED = "An error is the sensor's reading minus the prediction."
READS_TRUTH = "The sensor is ideal: it reads the true position."

RUN = re.compile(r"(.+) at (.+), (axis \S+|all axes)")
"""Label, place and axis in a statement on a run."""
MOST_STATEMENTS = 15
"""Most statements of a page; `report.json` has all."""

# What tells the rows of rms.csv apart; each figure of merit says itself what it is.
KEYS = {
    "compensator": "label of the compensator or model in the scenario; empty if the actuator is alone",
    "excited_axis": 'driven axis, with the others at zero; "all" if they were driven together',
    "measured_axis": "axis of the position",
    "frequency_hz": "frequency of the signal [Hz], the higher if it has two; 0 for a signal from a file",
    "amplitude_v": "amplitude or radius of the driving voltage [V]",
    "amplitude_um": "amplitude or radius of the reference [um]",
    "trial": "trial of a compensator that learns; the first is without learning",
}


def run_page(report: Report, figures: Iterable[str] = ()) -> Page:
    """Page of a report; equal reports give equal pages.

    Parameters
    ----------
    report : result of ``hammerstein.experiment.run.run``
    figures : names of its files beside the page, of which the SVG are shown

    Examples
    --------
    >>> from hammerstein.experiment.run import run
    >>> from hammerstein.scenario.scenario import Scenario
    >>> scenario = Scenario.model_validate({
    ...     "question": "How large is a loop?", "actuator": "duo_bimorph_static",
    ...     "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0}})
    >>> print(run_page(run(scenario, "loop")).markdown().splitlines()[2])
    **How large is a loop?**
    """
    scenario, judged = report.scenario, report.judgements
    asked = scenario.assessment
    place = "" if asked is None else asked.place()
    met, open_ = sum(j.agrees for j in judged), [j.word for j in judged].count("undecided")
    claims = f"{met} of {len(judged)} claims met{f', {open_} undecided' * bool(open_)}"
    begun = place[:1].upper() + place[1:]
    printed = Markdown("{} (*{}*).").format(begun, asked.source()) if asked and place else ""
    return Page(
        heading=paragraphs(
            [Markdown("# {}").format(report.name), Markdown("**{}**").format(scenario.question), printed]
        ),
        what=" · ".join([report.name, place] if place else [report.name]),
        title=scenario.question,
        answer=_answer(report),
        body=_body(report, sorted((name for name in figures if name.endswith(".svg")), key=place_of)),
        facts=list(_facts(report)),
        verdict=Judged(claims, met == len(judged)) if judged else None,
        numbers=list(_number_files(report)),
    )


def _answer(report: Report) -> Markdown:
    """The answer with its labels in italics; no text of the scenario is taken for Markdown."""
    opening, closing = "\ue000", "\ue001"

    def quoted(label: str) -> str:
        return opening + re.sub(f"[{opening}{closing}]", "", label) + closing

    def told(text: str) -> Markdown:
        return Markdown(re.sub(f"[{opening}{closing}]", "*", markdown(text)))

    parts = []
    for sentence in sentences(report, quoted):
        parts.append(told(sentence.words))
        lines = [Markdown(" | ").join(map(told, row)) for row in sentence.table]
        if lines:
            rule = Markdown(" | ").join(["---", *["---:"] * (len(sentence.table[0]) - 1)])
            lines = [Markdown("| {} |").format(line) for line in (lines[0], rule, *lines[1:])]
            parts.append(Markdown("\n").join(lines))
    return paragraphs(parts)


def _body(report: Report, figures: Sequence[str]) -> Markdown:
    statements, scenario, judged = gathered(report.statements), report.scenario, report.judgements
    return markdown_page(
        "report.md.jinja",
        report=report,
        figures=figures_section(figure_of(name, report) for name in figures),
        statements=statements[:MOST_STATEMENTS],
        unsaid=len(statements[MOST_STATEMENTS:]),
        tables=number_tables(report),
        setting=list(setting_of(report)),
        sources=_filled([source_of(source) for source in (*scenario.compensators, *scenario.models)]),
        glossary=glossary_of(report),
        asked=scenario.assessment,
        judged=list(zip([j.agrees for j in judged], _filled([j.cells() for j in judged]), strict=True)),
    ).strip()


def _filled(lines: Sequence[dict[str, str]]) -> list[dict[str, str]]:
    """Lines of a table, by column, without the columns that are empty in all of them."""
    return [
        {name: text for name, text in line.items() if any(other[name] for other in lines)} for line in lines
    ]


def _facts(report: Report) -> Iterator[str]:
    scenario = report.scenario
    yield report.actuator
    for number, what in ((len(scenario.compensators), "compensator"), (len(scenario.models), "model")):
        if number:
            yield number_of(number, what)
    if found := span([(row.frequency_hz, "Hz") for row in report.rows if row.frequency_hz]):
        yield found
    yield f"{report.signal} {'in V' if scenario.drive is not None else 'in um'}"


def _number_files(report: Report) -> Iterator[NumberFile]:
    yield NumberFile("report.json", report.to_json())
    yield NumberFile("rms.csv", report.to_csv(), "text/csv")
    if report.bands:
        yield NumberFile("bands.csv", report.bands_to_csv(), "text/csv")
    if report.sensitivities:
        yield NumberFile("sensitivities.csv", report.sensitivities_to_csv(), "text/csv")


def gathered(statements: Sequence[str]) -> list[str]:
    """Statements; equal ones on several items are joined.

    >>> gathered(["plays: no inverse", "The sensor lags.", "Bouc-Wen: no inverse"])
    ['plays; Bouc-Wen: no inverse', 'The sensor lags.']
    """
    about: dict[str, list[str]] = {}
    for statement in statements:
        of, _, said = statement.partition(": ")
        about.setdefault(said or statement, []).extend([of] if said else [])
    return ["; ".join(_merged(dict.fromkeys(of))) + ": " * bool(of) + said for said, of in about.items()]


def _merged(things: Iterable[str]) -> Iterator[str]:
    """Runs that differ in their axis or label alone, as one; other things as they are.

    >>> list(_merged(["a at 5 Hz, axis x", "a at 5 Hz, axis y", "b at 5 Hz, axis x", "b at 5 Hz, axis y"]))
    ['a; b, all at 5 Hz, axis x and axis y']
    """
    runs: dict[str, dict[str, list[str]]] = {}
    for thing in things:
        if found := RUN.fullmatch(thing):
            label, place, axis = found.groups()
            runs.setdefault(place, {}).setdefault(label, []).append(axis)
        else:
            yield thing
    for place, axes in runs.items():
        for each in dict.fromkeys(map(tuple, axes.values())):
            labels = [label for label, own in axes.items() if tuple(own) == each]
            yield f"{'; '.join(labels)}{', all' * (len(labels) > 1)} at {place}, {' and '.join(each)}"


def _kind(name: str) -> str:
    """First words of a file name that TITLES knows; empty if none does."""
    return next((kind for kind in TITLES if name.startswith(kind)), "")


def place_of(name: str) -> tuple[int, str]:
    """Order on the page."""
    return [*TITLES, ""].index(_kind(name)), name


def figure_of(name: str, report: Report) -> Shown:
    """Title and caption of the figure of a file."""
    kind, stem = _kind(name), PurePath(name).stem
    compared, models = report.scenario.reference is not None, report.scenario.models
    banded = ["Median and 5 to 95 % of the random actuators, beside the nominal one."] * bool(report.bands)
    identified = ["A star marks the frequency at which a model was identified."] * bool(report.identified_at)
    remarks = {
        "loops": ["The wide grey line is the ideal response.", _lag(report)] * compared
        + ["Dark dashes show the models."] * bool(models and len(models) <= MOST_OVERLAYS),
        **dict.fromkeys(("sweep", "sweep_true"), identified + banded),
        "path": [f"Short dashes: the {'reference' if compared else 'prediction'}."],
        "trials_true": banded,
        "trials": banded,
        "errors": [READS_TRUTH if report.reads_truth else IS_TRUE if compared else NOT_PREDICTED]
        + ["Dots are samples, few in each turn; smooth curves join them."] * any(map(_sparse, report.traces)),
    }
    caption = " ".join([CAPTIONS.get(kind, ""), *remarks.get(kind, [])])
    return Shown(stem, TITLES.get(kind, stem), caption)


def _sparse(trace: Trace) -> bool:
    return trace.signal.smooth and is_sparse(trace.time_s, 1.0 / trace.signal.highest_frequency_hz)


def _lag(report: Report) -> str:
    """What a first-order sensor alone opens of a straight loop: sin(atan(f / f_b)) of its height."""
    bandwidth = report.instruments.sensor.bandwidth_hz
    highest = max(row.frequency_hz for row in report.rows)
    if math.isinf(bandwidth) or not report.reading_first:
        return ""
    opened = math.sin(math.atan(highest / bandwidth))
    return (
        f"The curves are sensor readings: the lag of the {bandwidth:g} Hz sensor alone opens a "
        f"straight line into a loop, {percent(opened)} of its height wide at {highest:g} Hz."
    )


def glossary_of(report: Report) -> list[tuple[str, str]]:
    """Descriptions of the columns of this report."""
    meanings = KEYS | {name: metric.meaning for name, metric in METRICS.items()}
    return [
        (name, meaning)
        for name, meaning in meanings.items()
        if any(getattr(row, name) not in (None, "") for row in report.rows)
    ]


def setting_of(report: Report) -> Iterator[tuple[str, str]]:
    """Settings of the run, as pairs of name and text."""
    scenario, portable = report.scenario, report.scenario.portable()
    model = HammersteinModel.load(scenario.actuator)
    yield "Actuator", Markdown("{}, dynamics: {}").format(code(report.actuator), model.dynamics.describe())
    for name in ("drive", "reference"):
        if name in portable:
            kind = {"kind": portable[name]["kind"]}
            yield ("Drive in V" if name == "drive" else "Reference in um"), _listed(kind | portable[name])
    if portable.get("sweep"):
        yield "Swept", _listed(portable["sweep"])
    if scenario.uncertainty is not None:
        yield "Drawn actuators, relative deviations", _listed(scenario.uncertainty.model_dump())
    yield "Measured", _listed(scenario.measure.model_dump())
    yield "Converter and amplifier", _listed(report.instruments.drive.model_dump())
    yield "Sensor", _listed(report.instruments.sensor.model_dump())
    yield "Seed of the noise", str(scenario.seed)
    yield "Digest of the scenario", code(report.digest)
    yield "Digest of the actuator's model", code(report.model_digest)


def source_of(source: ModelSource) -> dict[str, str]:
    """Label, law, settings and origin of a compensator or model, by column."""
    described = (inspect.getdoc(type(source)) or "").splitlines()
    is_law = hasattr(source, "law")
    what = described[0].rstrip(".") if is_law and described else "Prandtl-Ishlinskii model"
    own = source.model_dump(
        mode="json", exclude_defaults=True, exclude={"label", "law", "identification", "model"}
    )
    origin = f"file {PurePath(str(source.model)).name}"
    if source.identification is not None:
        found = source.identification.model_dump(mode="json", exclude_none=True)
        origin = f"identified: {_listed(found, plain=True)}"
    return {
        "compensator" if is_law else "model": source.label,
        "law or model": what,
        "settings": _listed(own, plain=True),
        "source of its model": origin,
    }


def _listed(values: dict[str, Any], plain: bool = False) -> str:
    """Keys and values in one line, as in ``frequency_hz = 50, amplitude_v = 10``."""
    texts = [f"{key} = {_value(value)}" for key, value in values.items() if value is not None]
    return ", ".join(texts) if plain else Markdown(", ").join(map(code, texts))


def _value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(_value(v) for v in value)}]"
    if isinstance(value, float):
        return "unlimited" if math.isinf(value) else f"{value:.6g}"
    return str(value).lower() if isinstance(value, bool) else str(value)
