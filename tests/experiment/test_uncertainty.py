import numpy as np
import pytest

import hammerstein
from hammerstein.blocks.instruments import Instruments
from hammerstein.commands.scenarios import WORTH_PROCESSES_S, process_pool
from hammerstein.errors import InputError
from hammerstein.experiment.draws import Figures, _bands, drawn_metrics
from hammerstein.experiment.report import number
from hammerstein.experiment.run import run
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.reporting.overview import write_overview
from hammerstein.runtime.parallel_tasks import Processes
from hammerstein.scenario import Scenario
from hammerstein.scenario.variation import Uncertainty


def _scenario(**uncertainty):
    return Scenario.model_validate(
        {
            "question": "?",
            "reference": {"kind": "sine", "amplitude_um": 20, "frequency_hz": 100, "axis": 1},
            "compensators": [{"label": "none", "law": "none", "identification": {}}],
            "uncertainty": {"draws": 8} | uncertainty,
        }
    )


def test_draws_have_the_spread_that_was_asked():
    model = HammersteinModel.load("duo_bimorph_creep")
    spec = Uncertainty(weights=0.05, resonance=0.01, damping=0.1, creep=0.2, noise=0.3)
    drawn = [spec.draw(model, Instruments(), n) for n in range(400)]
    axes = [m.dynamics.axes[0] for m, _ in drawn]
    nominal = model.dynamics.axes[0]
    assert np.std([np.log(a.resonance_hz / nominal.resonance_hz) for a in axes]) == pytest.approx(
        0.01, rel=0.15
    )
    assert np.std([np.log(a.damping_ratio / nominal.damping_ratio) for a in axes]) == pytest.approx(
        0.1, rel=0.15
    )
    gains = [np.log(a.creep[1].gain / nominal.creep[1].gain) for a in axes]
    assert np.std(gains) == pytest.approx(0.2, rel=0.15)
    weights = np.array([m.hysteresis.pairs[0][0].weights_um_per_v for m, _ in drawn])
    own = model.hysteresis.pairs[0][0].weights_um_per_v
    np.testing.assert_allclose(weights.std(axis=0), 0.05 * np.abs(own), rtol=0.2)
    noise = [i.sensor.noise_um for _, i in drawn]
    assert np.std(np.log(noise)) == pytest.approx(0.3, rel=0.15)


def test_a_draw_does_not_depend_on_how_many_are_drawn():
    model = HammersteinModel.load("duo_bimorph")
    one, many = (Uncertainty(draws=n, weights=0.1).draw(model, Instruments(), 3)[0] for n in (4, 400))
    assert one.digest() == many.digest()
    assert one.digest() != Uncertainty(weights=0.1).draw(model, Instruments(), 4)[0].digest()


def test_bands_contain_the_nominal_run_and_widen_with_the_uncertainty():
    narrow, wide = (run(_scenario(resonance=s, weights=s)) for s in (0.002, 0.05))
    nominal = {row.measured_axis: row.rms_true_um for row in wide.rows}
    widths = []
    for report in (narrow, wide):
        band = next(b for b in report.bands if b.metric == "rms_true_um" and b.measured_axis == "x")
        assert band.p5_um <= band.median_um <= band.p95_um
        assert band.median_um == pytest.approx(nominal["x"], rel=0.2)
        widths.append(band.p95_um - band.p5_um)
    assert widths[1] > 5 * widths[0]


def test_nothing_uncertain_leaves_the_position_as_it_is():
    report = run(_scenario())
    nominal = {row.measured_axis: row.rms_true_um for row in report.rows}
    for band in report.bands:
        if band.metric == "rms_true_um":
            assert band.p5_um == band.p95_um == pytest.approx(nominal[band.measured_axis], rel=1e-12)
        elif band.metric == "rms_um":
            assert band.p5_um < band.p95_um  # each draw has another noise of the sensor


def test_a_band_holds_nine_tenths_of_the_draws():
    values = np.full((101, 1, len(drawn_metrics())), np.nan)
    values[:, 0, drawn_metrics().index("rms_um")] = np.arange(101.0)
    row = (Row("a", "x", "x", 50.0),)
    (band,) = _bands(Figures(row, values))
    assert (band.p5_um, band.median_um, band.p95_um) == (5.0, 50.0, 95.0)


def test_bands_depend_neither_on_jobs_nor_on_the_run():
    assert len({run(_scenario(resonance=0.01), jobs=jobs).to_json() for jobs in (1, 2)}) == 1


def test_what_does_not_exist_cannot_be_uncertain():
    scenario = _scenario(weights="standard_errors")
    with pytest.raises(InputError, match="covariance of its weights"):
        run(scenario)
    static = _scenario(resonance=0.1).model_copy(update={"actuator": "duo_bimorph_static"})
    with pytest.raises(InputError, match="no axes with a resonance"):
        run(static)


def test_a_card_shows_the_band_and_what_was_learnt(tmp_path):
    """Of drawn actuators the median and the band; of trials those of the last one."""
    scenario = {
        "question": "How far is it off?",
        "actuator": "duo_bimorph",
        "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 80.0},
        "measure": {"settle_cycles": 3, "measured_cycles": 4},
        "sweep": {"trial": [1, 2]},
        "uncertainty": {"draws": 4, "weights": 0.05},
        "compensators": [{"label": "learned", "law": "learned", "model": "duo_bimorph"}],
    }
    report = run(scenario, "far")
    write_overview([report], tmp_path)
    page = (tmp_path / "index.html").read_text().replace("\xa0", " ")  # none is parted from its unit
    last = [b for b in report.bands if b.trial == 2 and b.metric == "euclidean_max_true_um"]
    worst = max(last, key=lambda band: band.p95_um)
    shown = f"{number(worst.median_um)} ({number(worst.p5_um)} to {number(worst.p95_um)}) um"
    assert " in trial 2 over 4 random actuators, median (5 to 95 %)" in page
    assert shown in page


@pytest.mark.full
def test_draws_in_processes_are_those_of_this_process():
    scenario = {
        "question": "How wide is the band?",
        "actuator": "duo_bimorph_static",
        "reference": {"kind": "circle", "radius_um": 20.0, "frequency_hz": 50.0},
        "compensators": [{"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"}],
        "uncertainty": {"draws": 60, "weights": 0.05},
    }
    with Processes(2) as crew:
        there = hammerstein.run(scenario, jobs=crew)
    assert there.to_json() == hammerstein.run(scenario, jobs=1).to_json()


def test_many_short_runs_that_take_long_together_have_processes():
    with process_pool(2, 1.1 * WORTH_PROCESSES_S) as crew:
        assert isinstance(crew, Processes)
    assert [process_pool(*asked).__enter__() for asked in ((2, 0.9 * WORTH_PROCESSES_S), (1, 1e9))] == [2, 1]
