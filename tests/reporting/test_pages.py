"""Pages for a browser: what they hold, and what a real browser makes of them."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from browser import Page, browser, program

from hammerstein.commands.cli import main
from hammerstein.escaping import Markdown
from hammerstein.model import HammersteinModel
from hammerstein.regression.compare import Finding, Kind
from hammerstein.regression.result import CheckResult, ScenarioCheck
from hammerstein.reporting import page as page_module
from hammerstein.reporting.check_page import check_page
from hammerstein.reporting.figures.moved import courses_of, moved_figure
from hammerstein.reporting.page import NumberFile, html_of, inlined
from hammerstein.scenario.scenario import Tolerance

EVIL = "</script><script>window.hit=1</script><img src=x onerror=window.hit=2>$$x$$ &lt; =1+1"
SWEPT = f"""
question = {json.dumps("Is it small? " + EVIL)}
actuator = "evil.json"
[reference]
kind = "sine"
amplitude_um = 15
frequency_hz = 50
[sweep]
frequency_hz = [10, 20, 40, 50, 60, 80, 100]
[measure]
settle_cycles = 1
measured_cycles = 1
[[compensators]]
label = {json.dumps(EVIL[:58])}
law = "none"
model = "evil.json"
[[compensators]]
label = "second"
law = "exact_inverse"
model = "evil.json"
[assessment]
kind = "paper"
[[assessment.claims]]
id = {json.dumps(EVIL)}
statement = {json.dumps(EVIL)}
paper = 1.0
quote = {json.dumps(EVIL)}
unit = "<b>"
quantity = {{ metric = "rms_um", measured_axis = "x<b>", compensator = "second", frequency_hz = 50 }}
agreement = {{ within = 2.0 }}
note = {json.dumps(EVIL)}
"""
CIRCLE = """
question = "How round is a small circle?"
actuator = "duo_bimorph_static"
[reference]
kind = "circle"
radius_um = 15
frequency_hz = 50
[[compensators]]
label = "none"
law = "none"
model = "duo_bimorph_static"
"""
INTERACTIVE = ("reports/swept/report.html", "reports/circle/report.html")
PAGES = (*INTERACTIVE, "reports/index.html", "plain/swept/report.html", "stage_fit/report.html", "check.html")


def call(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Every kind of page, of a hostile scenario, of a circle, of a fit, and of a check that fails."""
    folder = tmp_path_factory.mktemp("pages")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        content = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
        content |= {"name": EVIL, "inputs": ["u<script>", "v"], "outputs": ["x<b>", "y"]}
        Path("evil.json").write_text(json.dumps(content))
        Path("all").mkdir()
        Path("all/evil.json").write_text(json.dumps(content))
        Path("all/swept.toml").write_text(SWEPT)
        Path("all/circle.toml").write_text(CIRCLE)
        assert call("run", "all", "--jobs", "1", "--interactive") == 0
        assert call("run", "all/swept.toml", "--out", "plain") == 0
        t = np.arange(3000) / 20e3
        u = 10.0 * np.sin(2.0 * np.pi * 50.0 * t)
        x = HammersteinModel.load("duo_bimorph_static").hysteresis.respond(np.vstack([u, 0.0 * u]))[0][0]
        pd.DataFrame({"t": t, "u<b>": u, "x<script>": x}).to_csv("r.csv", index=False)
        columns = ("--inputs", "u<b>", "--outputs", "x<script>", "--time", "t", "--out", "stage.json")
        assert call("identify", "r.csv", *columns) == 0
        assert call("check", "all", "--jobs", "1", "--update-baseline") == 0
        baseline = Path("reports/baseline/swept.json")
        held = json.loads(baseline.read_text())
        for row in held["rows"]:
            if "rms_um" in row["numbers"]:
                row["numbers"]["rms_um"] *= 1.01
        baseline.write_text(json.dumps(held))
        assert call("check", "all", "--jobs", "1", "--html", "check.html") == 1
        yield folder


class Reader(HTMLParser):
    """Tags, addresses and texts of a page, as a browser reads them."""

    def __init__(self, text: str):
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.ids: list[str] = []
        self.images_without_text = 0
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append(tag)
        self.addresses += [str(found[name]) for name in ("src", "href", "action") if name in found]
        self.ids += [str(found["id"])] if "id" in found else []
        if tag == "img":
            self.images_without_text += not found.get("alt")
        if tag == "svg":  # a part of a drawing, which has a text as a whole
            self.images_without_text += "aria-hidden" not in found
        if found.get("role") == "img":
            self.images_without_text += not found.get("aria-label")
        assert not [name for name in found if name.startswith("on")]


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_one_file_and_holds_no_text_of_strangers_as_markup(folder: Path, name: str) -> None:
    page = Reader((folder / name).read_text())
    scripts = 1 + 4 * (name in INTERACTIVE)  # our own; two of bokeh, the data, the start
    scripts += name in INTERACTIVE  # and bokeh's word on what to log
    assert page.tags.count("script") == scripts
    assert "b" not in page.tags
    outside = [
        a
        for a in page.addresses
        if not re.match(r"data:|#|(swept|circle)/|rms\.csv|report\.json|fit\.json", a)
    ]
    assert outside == []
    assert len(page.ids) == len(set(page.ids))
    assert page.images_without_text == 0
    assert page.tags.count("svg") >= (0 if "index" in name else 1)


@pytest.mark.parametrize("name", PAGES)
def test_pages_stay_small(folder: Path, name: str) -> None:
    assert (folder / name).stat().st_size <= (3_000_000 if name in INTERACTIVE else 1_500_000)


@pytest.mark.full
def test_two_runs_give_the_same_pages(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In another order and folder, so that nothing counts on from page to page."""
    monkeypatch.chdir(folder)
    assert call("run", "all/circle.toml", "--out", "again", "--interactive") == 0
    first, second = (folder / where / "circle/report.html" for where in ("reports", "again"))
    assert first.read_bytes() == second.read_bytes()


def test_without_the_library_the_command_says_what_to_install(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert call("run", "all/circle.toml", "--interactive", "--out", "none") == 2
    assert "python -m pip install 'hammerstein-control[interactive]'" in capsys.readouterr().err
    assert not (folder / "none").exists()


def test_open_shows_the_page(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda url: opened.append(url) or len(opened) == 1)
    for _ in range(2):
        assert call("run", "all/circle.toml", "--no-figures", "--out", "opened", "--open") == 0
    assert opened == [(folder / "opened/circle/report.html").as_uri()] * 2
    assert "no browser could be started" in capsys.readouterr().err


def test_a_small_file_comes_along_and_a_large_one_is_linked() -> None:
    assert NumberFile("rms.csv", "a,b\n", "text/csv").href == "data:text/csv;charset=utf-8;base64,YSxiCg=="
    assert NumberFile("rms.csv", "x" * 200_001, "text/csv").href == "rms.csv"


def test_markdown_of_ours_is_read_and_html_is_not() -> None:
    option = html_of(Markdown("`run x.csv --out-a b--c`"))[0]  # in which no line ends on a telephone
    assert option == '<p><code>run x.csv <span class="option">--out-a</span> b--c</code></p>\n'
    assert html_of(Markdown("*a* <b>"))[0] == "<p><em>a</em> &lt;b&gt;</p>\n"
    assert html_of(Markdown("{}").format("*a* <b>"))[0] == "<p>*a* &lt;b&gt;</p>\n"


@pytest.mark.parametrize("label", ["1. try", "2) try", "- none", "+ 5 %", "# 1", "-3 um", "1.5 V", "> 3"])
def test_a_label_opens_no_list_in_a_list(label: str) -> None:
    shown, _ = html_of(Markdown("* {}").format(label))
    assert shown.replace("\xa0", " ") == f"<ul>\n<li>{label.replace('>', '&gt;')}</li>\n</ul>\n"


def test_short_heads_are_level_and_nothing_is_parted_from_what_it_numbers() -> None:
    """Heads such as 10 Hz were turned upright; titles and bounds were broken before a unit or a number."""
    table = Markdown("| [um] | 10 Hz | frequency [Hz] |\n| --- | --- | --- |\n| a | < 1e-6 | b, trial 1 |\n")
    shown, _ = html_of(table)
    assert "<th>10\xa0Hz</th>" in shown
    assert re.findall(r'<th class="upright">(.*?)</th>', shown) == ["frequency [Hz]"]
    assert "&lt;\xa01e-6" in shown
    assert "b, trial\xa01" in shown
    page = page_module.Page(Markdown("# wide"), "wide", "A 50 um circle?", Markdown(), Markdown())
    assert "<h1>A 50\xa0um circle?</h1>" in page.html({})


def test_drawings_of_one_page_share_no_id_and_keep_their_references() -> None:
    svg = (
        b'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        b'viewBox="0 0 576 100"><svg class="axes" x="0" y="50" width="288" height="50">'
        b'<g id="unused"><path id="m1" d="M1 2"/></g>'
        b'<use xlink:href="#m1" clip-path="url(#c1)"/></svg><defs><clipPath id="c1"/></defs></svg>'
    )
    one, two = inlined(svg, "f1", 'a "b"'), inlined(svg, "f2", "b")
    assert 'id="f1-m1"' in one
    assert 'href="#f1-m1"' in one
    assert "url(#f1-c1)" in one
    assert "unused" not in one
    assert "--x:0.00%;--y:50.00%;--w:50.00%" in one
    assert not set(re.findall('id="([^"]+)"', one)) & set(re.findall('id="([^"]+)"', two))
    assert 'aria-label="a &#34;b&#34;"' in one


def test_courses_tell_how_far_a_number_moved_in_units_of_what_is_allowed() -> None:
    keys = [(("frequency_hz", f), ("measured_axis", axis)) for axis in "xy" for f in (50.0, 10.0)]
    accepted = {key: {"rms_um": 2.0} for key in keys}
    now = accepted | {keys[2]: {"rms_um": 2.1}}
    y, x = courses_of("rms_um", accepted, now, {"rms_um": Tolerance(relative=0.01, absolute=0.0)})
    assert (y.label, x.label) == ("position y", "position x")
    assert y.x.tolist() == [10.0, 50.0]
    assert y.now.tolist() == [2.0, 2.1]
    assert y.excess == pytest.approx(0.1 / 0.02)
    assert x.excess == 0.0


def test_a_number_of_all_axes_is_one_course() -> None:
    """The distance was drawn for x and for y: two of three courses showed the same."""
    keys = [(("compensator", law), ("measured_axis", axis)) for law in ("a", "b") for axis in "xy"]
    accepted = {key: {"euclidean_max_um": 2.0, "max_um": 1.0} for key in keys}
    now = {key: {"euclidean_max_um": 2.1, "max_um": 1.0 + n} for n, key in enumerate(keys)}
    labels = [course.label for course in courses_of("euclidean_max_um", accepted, now, {})]
    assert labels == ["a", "b"]
    assert len(courses_of("max_um", accepted, now, {})) == 4


def test_numbers_that_nothing_was_swept_for_are_dots_beside_each_other() -> None:
    keys = [(("compensator", "exact"), ("measured_axis", axis)) for axis in "xy"]
    accepted = {key: {"rms_true_um": 1e-3} for key in keys}
    now = accepted | {keys[0]: {"rms_true_um": 1.0}}
    courses = courses_of(
        "rms_true_um", accepted, now, {"rms_true_um": Tolerance(relative=0.01, absolute=0.0)}
    )
    left, right = moved_figure(courses, "rms_true_um").axes
    assert left.get_ylabel() == "rms true [µm]"
    assert right.get_yscale() == "log"
    places = [float(line.get_xdata()[0]) for line in left.lines if line.get_marker() == "o"]
    assert places == [1.0, 2.0]
    assert left.get_xticks().tolist() == [1, 2]
    assert left.get_xlabel() == "place in the legend"
    by_colour = {
        line.get_color() for line in left.lines if line.get_linewidth() == 4.0 and len(line.get_xdata())
    }
    assert len(by_colour) == 2  # a baseline has the colour of its curve, or crossing ones were mixed up
    assert right.get_title("right") == "grey: allowed; lowest: 0.1 or less"


def test_a_check_without_a_common_row_has_a_page() -> None:
    rows = [{(("amplitude_um", size), ("measured_axis", "x")): {"rms_um": 2.0}} for size in (20.0, 21.0)]
    findings = (Finding(Kind.MISSING_ROW, *rows[0]), Finding(Kind.EXTRA_ROW, *rows[1]))
    check = ScenarioCheck("circle", Path("circle.toml"), 1, findings, accepted=rows[0], now=rows[1])
    page = check_page(CheckResult((check,)))
    assert "<figure" not in page
    assert "There is no figure: this run has no number of the baseline." in page


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    path = program()
    if path is None:
        pytest.skip("no Chromium is here: no page was opened in a browser")
    with browser(path) as found:
        yield found


def opened(page: Page, path: Path, width: int = 1400) -> Page:
    page.open(path, width)
    if path.as_posix().endswith(INTERACTIVE):
        page.wait("window.Bokeh && Bokeh.documents.length && Bokeh.documents[0].is_idle")
    return page


@pytest.mark.parametrize("width", [390, 1400])
def test_no_table_of_a_check_scrolls_sideways(folder: Path, page: Page, width: int) -> None:
    opened(page, folder / "check.html", width)
    boxes = "[...document.querySelectorAll('.scroll, pre')]"
    assert page.value(f"{boxes}.length") >= 3
    assert page.value(f"{boxes}.filter(e => e.scrollWidth > e.clientWidth).map(e => e.textContent)") == []


@pytest.mark.parametrize("width", [400, 1400])
@pytest.mark.parametrize("name", PAGES)
def test_a_browser_shows_it_without_complaint(folder: Path, page: Page, name: str, width: int) -> None:
    opened(page, folder / name, width)
    assert page.complaints == []
    assert all(address.startswith("file:") for address in page.requests)
    assert len([a for a in page.requests if not a.endswith(".svg")]) == 1
    assert page.value("window.hit === undefined")
    assert page.value("document.documentElement.scrollWidth") <= width
    assert page.value(
        "[...document.querySelectorAll('.draw')].every(draw => draw.scrollWidth <= draw.clientWidth)"
    )


PARTS = """[...document.querySelectorAll(".drawing")]
    .map(drawing => [...drawing.querySelectorAll("svg[viewBox]")]
    .map(part => [part.classList[0], part.getBoundingClientRect(), part.viewBox.baseVal.width])
    .map(([kind, room, points]) => ({kind, left: room.left, right: room.right, top: room.top,
        bottom: room.bottom, letter: 9 * room.width / points})))"""


@pytest.mark.parametrize("name", [name for name in PAGES if "index" not in name])
def test_a_telephone_shows_panels_below_each_other_in_legible_letters(
    folder: Path, page: Page, name: str
) -> None:
    opened(page, folder / name, 390)
    drawings = page.value(PARTS)
    assert drawings
    for parts in drawings:
        assert min(part["letter"] for part in parts) >= 10.0
        assert max(part["right"] for part in parts) <= 390.0
        panels = [part for part in parts if part["kind"] == "axes"]
        for one, other in itertools.pairwise(panels):
            assert other["top"] >= one["bottom"]
            assert other["left"] == pytest.approx(one["left"], abs=1.0)


@pytest.mark.parametrize("name", [name for name in PAGES if "index" not in name])
def test_a_desk_shows_a_drawing_as_it_was_laid_out(folder: Path, page: Page, name: str) -> None:
    opened(page, folder / name, 1400)
    for parts in page.value(PARTS):
        panels = [part for part in parts if part["kind"] == "axes"]
        for one, other in itertools.combinations(parts, 2):  # nothing hides another
            assert (
                min(one["right"], other["right"]) - max(one["left"], other["left"]) < 12.0
                or min(one["bottom"], other["bottom"]) - max(one["top"], other["top"]) < 12.0
            )
        assert np.ptp([part["letter"] for part in parts]) < 0.1
        assert len(panels) < 2 or any(panel["left"] > panels[0]["right"] - 12.0 for panel in panels)


@pytest.mark.parametrize(("width", "wrapped"), [(400, "anywhere"), (1400, "break-word")])
def test_names_in_a_table_of_words_are_broken_on_a_telephone_alone(
    folder: Path, page: Page, width: int, wrapped: str
) -> None:
    """A column may be as narrow as its longest word, not as a letter: `linear_gain.j son`."""
    opened(page, folder / "plain/swept/report.html", width)
    assert page.value("getComputedStyle(document.querySelector('.words td')).overflowWrap") == wrapped


@pytest.mark.parametrize("width", [400, 1000, 1400])
def test_the_table_of_claims_is_as_wide_as_the_page(folder: Path, page: Page, width: int) -> None:
    opened(page, folder / "plain/swept/report.html", width)
    table = "document.querySelector('#claims-of-the-paper ~ .scroll')"
    assert page.value(f"{table}.textContent").count("onerror") == 2  # id and statement
    assert page.value(f"{table}.scrollWidth - {table}.clientWidth") == 0


WIDE = (
    "## Numbers\n\n| compensator | frequency [Hz] | amplitude [um] | x, rms / worst | y, rms / worst "
    "| distance, rms | distance, worst | radius, worst |\n|" + " --- |" * 8 + "\n"
    "| hysteresis and dynamics | 100 | 48 | 0.000187 / 0.000444 | 0.000111 / 0.000208 | 0.000413 "
    "| 0.000472 | 0.000422 |\n"
)


def test_a_table_of_two_swept_quantities_fits_a_telephone(page: Page, tmp_path: Path) -> None:
    """It scrolled sideways: 750 points of numbers on a page of 390, and 470 with its name beside them."""
    wide = page_module.Page(Markdown("# wide"), "wide", "wide", Markdown("up to 3 um"), Markdown(WIDE))
    (tmp_path / "wide.html").write_text(wide.html({}), encoding="utf-8")
    opened(page, tmp_path / "wide.html", 390)
    assert page.value("(e => e.scrollWidth - e.clientWidth)(document.querySelector('.scroll'))") == 0
    assert page.value("document.querySelector('td:nth-child(4)').textContent") == "0.000187\xa0/ 0.000444"
    assert page.value("document.querySelector('.answer p').textContent") == "up to 3\xa0um"  # never "3" alone


ROWS = "[...document.querySelector('#numbers ~ .scroll table').tBodies[0].rows]"
COLUMN = f"{ROWS}.map(row => parseFloat(row.cells[1].textContent))"
TYPE = """{ const input = document.querySelector(".filter input"); input.value = "%s";
  input.dispatchEvent(new Event("input")); }"""


def test_tables_sort_and_filter(folder: Path, page: Page) -> None:
    opened(page, folder / "plain/swept/report.html")
    before = page.value(COLUMN)
    button = "document.querySelectorAll('#numbers ~ .scroll table thead button')[1]"
    for order in ("ascending", "descending"):
        page.value(f"{button}.scrollIntoView({{behavior: 'instant', block: 'center'}})")
        box = page.value(f"{button}.getBoundingClientRect().toJSON()")
        page.click(box["x"] + 5, box["y"] + 5)
        assert page.value(f"{button}.parentElement.ariaSort") == order
        assert page.value(COLUMN) == sorted(before, reverse=order == "descending")
    page.value(TYPE % "second")
    assert page.value(f"{ROWS}.filter(row => !row.hidden).length") == len(before) // 2


def test_the_overview_is_searched(folder: Path, page: Page) -> None:
    opened(page, folder / "reports/index.html")
    page.wait("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    page.value(TYPE % "ROUND small")
    shown = "[...document.querySelectorAll('.card')].filter(card => !card.hidden)"
    assert page.value(f"{shown}.map(card => card.querySelector('a').textContent)") == [
        "How round is a small circle?"
    ]


def test_it_reads_without_scripts(folder: Path, page: Page) -> None:
    page.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        page.open(folder / INTERACTIVE[0])
        text = page.value("document.body.innerText")
        assert page.complaints == []
    finally:
        page.call("Emulation.setScriptExecutionDisabled", value=False)
    assert "These plots need JavaScript" in text
    assert "rms error" in text
    assert page.value("document.querySelectorAll('figure svg').length") >= 2


def test_it_prints_on_paper(folder: Path, page: Page) -> None:
    opened(page, folder / "plain/swept/report.html")
    pdf = page.printed()
    boxes = re.findall(rb"/MediaBox ?\[ ?0 0 ([\d.]+) ([\d.]+)", pdf)
    assert boxes
    assert all(abs(float(w) - 595) < 2 and abs(float(h) - 842) < 2 for w, h in boxes)  # A4 in points


def test_its_parts_are_reached_by_the_keyboard_in_order(folder: Path, page: Page) -> None:
    opened(page, folder / "plain/swept/report.html")
    reached = []
    for _ in range(22):
        page.key("Tab", 9)
        reached.append(page.value("document.activeElement.getBoundingClientRect().top + window.scrollY"))
    assert reached[1:] == sorted(reached[1:])
    assert len(set(reached)) > 4


DEEP = """(() => { const walk = root => { for (const e of root.querySelectorAll("*")) {
  if (e.matches(%s)) return e; const found = e.shadowRoot && walk(e.shadowRoot); if (found) return found; } };
  const e = walk(document); e.scrollIntoView({behavior: "instant", block: "center"});
  return e.getBoundingClientRect().toJSON(); })()"""
MODELS = "[...Bokeh.documents[0]._all_models.values()]"


def test_a_click_on_the_legend_hides_a_curve_in_every_panel(folder: Path, page: Page) -> None:
    opened(page, folder / INTERACTIVE[0])
    curves = f"{MODELS}.filter(m => m.type === 'GlyphRenderer' && m.name && m.name.startsWith('</script>'))"
    total = page.value(f"{curves}.length")
    assert total > 8
    box = page.value(DEEP % '".bk-Legend"')
    page.click(box["x"] + 30, box["y"] + 34)  # below the title
    page.wait(f"{curves}.every(m => !m.visible)")
    page.click(box["x"] + 30, box["y"] + 34)  # below the title
    page.wait(f"{curves}.every(m => m.visible)")
    assert page.complaints == []


def test_the_slider_moves_through_the_sweep(folder: Path, page: Page) -> None:
    opened(page, folder / INTERACTIVE[0])
    box = page.value(DEEP % '".noUi-handle"')
    shown = f"{MODELS}.find(m => m.type === 'CategoricalSlider').value"
    errors = (
        f"{MODELS}.filter(m => m.type === 'ColumnDataSource').map(m => Array.from(m.get_column('y'))).flat()"
        ".reduce((a, b) => a + Math.abs(b), 0)"
    )
    assert page.value(shown) == "10 Hz"
    before = page.value(errors)
    page.click(box["x"] + 5, box["y"] + 5)
    page.key("ArrowRight", 39)
    page.wait(f"{shown} === '20 Hz'")
    page.wait(f"{errors} !== {before!r}")
    assert page.complaints == []
