"""Short texts of values, and their pictures in a notebook."""

import base64
import io
import re
from pathlib import Path

import control
import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

import hammerstein
from hammerstein.blocks.instruments import Instruments
from hammerstein.compensators import COMPENSATORS
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.records.record import Record
from hammerstein.reporting.notebook import picture_of

TIME = 1e-4 * np.arange(2000)
SINE = 8.0 * np.sin(2.0 * np.pi * 20.0 * TIME)
GUIDE = Path(hammerstein.__file__).parent / "guide" / "control.md"


@pytest.fixture(scope="module")
def model():
    return HammersteinModel.load("duo_bimorph")


@pytest.fixture(scope="module")
def response(model):
    return Plant(model, Instruments.ideal(1e-4)).respond(np.stack([SINE, 0.5 * SINE]), [0])


@pytest.fixture(scope="module")
def record(response):
    return Record(response.drive_v[:1], response.position_um[:1], 1e-4, ("u <x>",), ("x",), "a & b.csv")


def _picture(value):
    html = value._repr_html_()
    png = base64.b64decode(re.search(r'src="data:image/png;base64,([^"]*)"', html)[1])
    return html, Image.open(io.BytesIO(png))


def test_texts_are_short_and_say_what_it_is(model, response, record):
    said = {
        repr(model): [
            "duo_bimorph",
            "x, y [V] to x, y [um]",
            "15 operators a pair",
            "0.07 to 9.7 V",
            "279.7 Hz",
        ],
        repr(model.hysteresis): ["PrandtlIshlinskii(2 inputs, 2 outputs, 15 operators a pair"],
        repr(model.hysteresis.pairs[0][0]): ["Pair(15 operators", "6.231 um/V"],
        repr(hammerstein.Pair.absent()): ["Pair(absent)"],
        repr(hammerstein.discretise(model.dynamics, 5e-5)): [
            "LinearBlock(order 4, 2 inputs, 2 outputs, with a sample time of 50 us"
        ],
        repr(model.dynamics.block()): ["LinearBlock(order 4, 2 inputs, 2 outputs, continuous)"],
        repr(response): ["Response(2000 samples of 100 us, 2 inputs, 2 outputs; position -"],
        repr(record): ["Record('a & b.csv': 2000 samples of 100 us; u <x> -8 to 8 V; x -"],
    }
    for text, parts in said.items():
        assert len(text) < 250
        for part in parts:
            assert part in text
    uneven = hammerstein.PrandtlIshlinskii(
        [[hammerstein.Pair.linear(2.0), hammerstein.Pair([0.1, 2.0], [1.0, 1.0])]]
    )
    assert "2 inputs, 1 output, 1 to 2 operators a pair, thresholds 0 to 2 V" in repr(uneven)


@pytest.mark.parametrize("law", COMPENSATORS.kinds.values())
def test_a_designed_compensator_says_what_it_is(model, law):
    text = repr(law().design(model, range_v=10.0, sample_time_s=5e-5))
    assert re.fullmatch(r"\w+\(2 outputs, -10 to 10 V\)", text)


def test_so_does_what_runs_and_what_it_gives(model):
    law = hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=5e-5)
    assert repr(hammerstein.stream(law)) == f"Stream({law!r})"
    found = model.compensate(np.zeros((2, 9)), law="exact_inverse")
    said = "drive 0 to 0 V, predicted error up to 0 um"
    assert repr(found) == f"Compensation(9 samples of {found.law!r}; {said})"
    pair = hammerstein.PrandtlIshlinskii([[model.hysteresis.pairs[0][0]]])
    described = repr(pair.to_describing_function(range_v=10.0))
    assert described.startswith("HysteresisNonlinearity(amplitudes 0.07")


def test_the_text_of_a_report_does_not_hold_its_rows():
    loop = {"kind": "sine", "amplitude_v": 9.0, "frequency_hz": 50.0}
    report = hammerstein.run(
        {"question": "How large?", "actuator": "duo_bimorph_static", "drive": loop}, "loop"
    )
    assert repr(report) == "Report('loop' on duo_bimorph_static: 4 rows, 2 traces)"


def test_a_cut_drive_is_in_the_text(model):
    cut = Plant(model, Instruments()).respond(np.array([[0.0, 20.0, 20.0], [0.0, 0.0, 0.0]]), [0])
    assert "the range clipped 2 samples" in repr(cut)


@pytest.mark.full
def test_pictures_stand_in_the_page_itself(model, response, record):
    for value in (model, response, record):
        html, image = _picture(value)
        assert image.size[0] == (537 if isinstance(value, Record) else 1000)  # of one panel, of several
        assert np.ptp(np.asarray(image.convert("L"))) > 100
    assert "a &amp; b.csv" in html
    assert "u &lt;x&gt;" in html


def test_a_model_shows_its_settled_loops(model):
    figure = picture_of(model)
    loop = figure.axes[0].lines[0]
    half = model.hysteresis.pairs[0][0].amplitude(10.0)
    assert np.ptp(loop.get_ydata()) == pytest.approx(2.0 * half, rel=1e-9)
    assert loop.get_ydata()[0] == pytest.approx(loop.get_ydata()[-1], abs=1e-9)
    assert len(figure.axes) == 4


def test_a_response_shows_position_and_reference(model, response):
    assert len(picture_of(response).axes) == 3
    plant = Plant(model, Instruments.ideal(1e-4))
    followed = plant.respond(response.requested_v, [0], reference_um=response.position_um + 1.0).after(1800)
    lines = [line.get_ydata() for line in picture_of(followed).axes[1].lines]
    assert any(np.array_equal(line, followed.reference_um[0]) for line in lines)
    assert picture_of(response.after(1999)) is None


def test_what_has_no_picture_shows_its_text():
    ramp = Record([np.linspace(0.0, 5.0, 200)], [np.linspace(0.0, 20.0, 200)], 1e-3)
    assert picture_of(ramp) is None
    assert ramp._repr_html_().startswith("<p><code>Record(")


def test_the_first_example_of_the_guide_to_python_control_runs():
    """Through ``control.interconnect``, with the error that the report of such a path shows."""
    import matplotlib.pyplot as plt

    blocks = re.findall(r"```python\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (example,) = [block for block in blocks if "control.interconnect" in block]
    mpl.use("Agg")
    names = {}
    try:
        exec(compile(example, "control.md", "exec"), names)
    finally:
        plt.close("all")
    error = names["response"].outputs - names["reference"]
    assert np.sqrt(np.mean(error[:, 200:] ** 2)) < 2.0
    assert isinstance(names["chain"], control.InterconnectedSystem)


def test_a_report_and_a_fit_are_a_line_and_their_first_figure(record):
    scenario = {
        "question": "How large is a loop?",
        "actuator": "duo_bimorph_static",
        "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0},
    }
    report = hammerstein.run(scenario)
    assert repr(report).startswith("Report(")
    assert _picture(report)[1].width > 500
    assert "<img" not in report.without_traces()._repr_html_()
    settings = hammerstein.Settings(operators=5, partition="voltage", dynamics="none")
    _, fit = hammerstein.identify([record], settings)
    assert re.fullmatch(
        r"Fit\(static_hysteresis: x [\d.]+ % of the range on the fitted records.*\)", repr(fit)
    )
    assert _picture(fit)[1].width > 500
