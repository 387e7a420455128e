"""Which parameter costs how much: against closed forms, and what is printed before."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from hammerstein.blocks.instruments import Instruments
from hammerstein.commands.cli import main
from hammerstein.dynamics import AxesDynamics, Axis
from hammerstein.errors import InputError
from hammerstein.experiment.draws import Figures, _base, _indices, drawn_metrics
from hammerstein.experiment.run import run
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.reporting.figures.choice import figures_of
from hammerstein.scenario import Scenario
from hammerstein.scenario.variation import Uncertainty

SCENARIO = {
    "question": "?",
    "actuator": "duo_bimorph",
    "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 300.0, "axis": 1},
    "compensators": [{"label": "none", "law": "none", "model": "duo_bimorph"}],
    "uncertainty": {"draws": 30, "resonance": 0.02, "sensitivity": 32},
}


def indices(f, samples, sizes):
    """Indices, by parameter, of a function of groups of normal numbers of these sizes."""
    names = [f"parameter {k}" for k in range(len(sizes))]
    one, other = _base(Uncertainty(sensitivity=samples), sum(sizes))
    ends = np.cumsum(sizes)
    blocks = [one, other]
    for start, end in zip(ends - sizes, ends, strict=True):
        mixed = one.copy()
        mixed[:, start:end] = other[:, start:end]
        blocks.append(mixed)
    values = np.full((len(blocks) * samples, 1, len(drawn_metrics())), np.nan)
    values[:, 0, 0] = np.concatenate([f(block) for block in blocks])
    figures = Figures((Row("a", "x", "x", 1.0),), values)
    return {found.parameter: found for found in _indices(figures, names, samples, 1)}


def test_indices_of_a_sum_with_a_product_are_those_of_theory():
    """f = 3 a + b1 + b2 + 2 a c: V = 9 + 2 + 4; 9 is a's alone, 2 b's, none c's, and 4 of a with c."""
    found = indices(lambda z: 3.0 * z[:, 0] + z[:, 1] + z[:, 2] + 2.0 * z[:, 0] * z[:, 3], 4096, [1, 2, 1])
    a, b, c = found.values()
    assert (a.first, b.first, c.first) == pytest.approx((9 / 15, 2 / 15, 0.0), abs=0.03)
    assert (a.total, b.total, c.total) == pytest.approx((13 / 15, 2 / 15, 4 / 15), abs=0.03)
    for one in found.values():
        assert one.first_low <= one.first <= one.first_high
        assert one.total_low <= one.total <= one.total_high
        assert one.total_high - one.total_low < 0.2


def test_axes_without_a_resonance_have_none_that_is_uncertain(tmp_path):
    """They have a lag, and their weights are uncertain."""
    model = HammersteinModel.load("duo_bimorph")
    lagging = str(tmp_path / "lagging.json")
    replace(model, dynamics=AxesDynamics(axes=(Axis(lag_s=1e-3),) * 2)).save(lagging)
    asked = SCENARIO | {"uncertainty": {"draws": 2, "weights": 0.05, "sensitivity": 8}}
    report = run(asked | {"actuator": lagging})
    names = {found.parameter for found in report.sensitivities}
    assert "weights of x" in names
    assert not any(name.startswith(("resonance", "damping")) for name in names)
    with pytest.raises(InputError, match="no axes with a resonance"):
        run(SCENARIO | {"actuator": lagging})


def test_correlated_weights_are_one_group_whatever_turns_them():
    """A rotation of the whitened numbers is the same uncertainty: the index of their group stays."""
    turn, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    w = np.array([1.0, 2.0, 0.5])
    plain = indices(lambda z: z[:, :3] @ w + z[:, 3], 4096, [3, 1])
    turned = indices(lambda z: z[:, :3] @ (turn @ w) + z[:, 3], 4096, [3, 1])
    share = (w @ w) / (w @ w + 1.0)
    for found in (plain, turned):
        assert found["parameter 0"].first == pytest.approx(share, abs=0.03)
        assert found["parameter 0"].total == pytest.approx(share, abs=0.03)


def test_a_figure_that_does_not_move_has_no_cause():
    assert indices(lambda z: np.ones(len(z)), 64, [1, 1]) == {}


def test_the_numbers_of_a_draw_make_the_same_actuator():
    model, spec = HammersteinModel.load("duo_bimorph_creep"), Uncertainty(weights=0.1, creep=0.2, noise=0.3)
    size = sum(parameter.size for parameter in spec.parameters(model))
    normal = np.random.default_rng([spec.seed, 5]).standard_normal(size)
    drawn, given = spec.draw(model, Instruments(), 5), spec.of(model, Instruments(), normal)
    assert drawn[0].to_json() == given[0].to_json()
    assert drawn[1] == given[1]
    names = [parameter.name for parameter in spec.parameters(model) if parameter.varies]
    assert names == ["weights of x", "weights of y", "creep of x", "creep of y", "noise"]


@pytest.mark.full
def test_what_is_driven_alone_is_the_cause():
    """Along x near its resonance the error is that of x's dynamics; y's resonance moves y alone."""
    report = run(SCENARIO | {"uncertainty": SCENARIO["uncertainty"] | {"sensitivity": 256}})
    found = {(s.measured_axis, s.parameter): s for s in report.sensitivities if s.metric == "rms_true_um"}
    assert found["x", "resonance of x"].total > 0.85
    assert found["x", "resonance of y"].total < 0.05
    assert found["y", "resonance of y"].total > found["y", "resonance of x"].total
    assert "sensitivity" in figures_of(report)
    assert run(SCENARIO, jobs=2).to_json() == run(SCENARIO).to_json()
    without = SCENARIO | {"uncertainty": {"draws": 30, "resonance": 0.02}}
    assert run(without).bands == report.bands


def test_samples_are_a_power_of_two_and_something_varies():
    with pytest.raises(InputError, match="power of two, as a Sobol sequence needs it; 128 is near"):
        Uncertainty(sensitivity=100)
    still = SCENARIO | {"uncertainty": {"draws": 2, "sensitivity": 8}}
    with pytest.raises(InputError, match="nothing is uncertain"):
        run(still)
    assert Scenario.model_validate(SCENARIO).uncertainty.sensitivity == 32


TEXT = """
question = "?"
actuator = "duo_bimorph"
[reference]
kind = "circle"
radius_um = 10
frequency_hz = 50
smooth_start_s = 0.02
[uncertainty]
draws = 20
resonance = 0.02
weights = 0.05
sensitivity = {samples}
[[compensators]]
label = "a"
law = "none"
model = "duo_bimorph"
"""


def called(*arguments):
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return end.value.code or 0


def test_a_dry_run_prints_the_plan_and_runs_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "220")
    (tmp_path / "u.toml").write_text(TEXT.replace("{samples}", "1024"))
    assert called("run", tmp_path / "u.toml", "--out", tmp_path / "r", "--dry-run") == 0
    said = capsys.readouterr().out
    assert "6144 random actuators, (4 + 2) x 1024, in 1 runs each, for the sensitivities to 4" in said
    assert "GB" in said
    assert not (tmp_path / "r").exists()


def test_the_folder_has_table_figure_and_csv(tmp_path):
    (tmp_path / "u.toml").write_text(TEXT.replace("{samples}", "8"))
    assert called("run", tmp_path / "u.toml", "--out", tmp_path / "r", "--jobs", "1") == 0
    folder = tmp_path / "r" / "u"
    table = pd.read_csv(folder / "sensitivities.csv")
    assert set(table.parameter) == {f"{what} of {axis}" for what in ("weights", "resonance") for axis in "xy"}
    assert (folder / "sensitivity.svg").is_file()
    assert "Causes of the spread" in (folder / "report.md").read_text()
