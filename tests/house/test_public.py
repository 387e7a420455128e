import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version

import numpy as np
import pytest

import hammerstein

LOOP = {
    "question": "How large is the loop?",
    "actuator": "duo_bimorph_static",
    "drive": {"kind": "sine", "amplitude_v": 10.0, "frequency_hz": 50.0},
    "measure": {"settle_cycles": 1, "measured_cycles": 1},
}
FILE = """
question = "How large is the loop?"
actuator = "duo_bimorph_static"
drive = { kind = "sine", amplitude_v = 10.0, frequency_hz = 50.0 }
measure = { settle_cycles = 1, measured_cycles = 1 }
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "loop.toml"
    path.write_text(FILE)
    return path


def test_every_public_name_is_there():
    for name in hammerstein.__all__:
        assert getattr(hammerstein, name).__module__.startswith("hammerstein.")
    nouns = {"identify", "read_records", "Record", "simulate", "run", "check", "Circle", "ExactInverse"}
    assert nouns <= set(hammerstein.__all__) == set(dir(hammerstein))


def test_a_name_that_is_not_there():
    with pytest.raises(AttributeError, match="indentify"):
        _ = hammerstein.indentify


def test_the_version_is_that_of_the_installation():
    said = subprocess.run(
        [sys.executable, "-m", "hammerstein", "--version"], capture_output=True, text=True, check=True
    )
    assert said.stdout == f"hammerstein {version('hammerstein-control')}\n"
    assert hammerstein.__version__ == version("hammerstein-control")


def test_the_command_line_imports_nothing_heavy():
    heavy = {"numpy", "numba", "control", "pandas", "pydantic"}
    code = f"import sys, hammerstein.commands.cli; print(sorted({heavy} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_to_simulate_takes_neither_python_control_nor_what_identifies():
    """Each takes about as long to load as all else: the one brings pyplot, the other SciPy's statistics."""
    code = (
        "import sys, hammerstein as h\n"
        "from hammerstein.dynamics import AxesDynamics, Axis, CreepMode, discretise\n"
        "h.HammersteinModel.load('duo_bimorph').simulate([[0.0, 5.0], [0.0, 0.0]], 50e-6)\n"
        "slow = CreepMode(gain=0.1, time_constant_s=10.0)\n"
        "discretise(AxesDynamics(axes=[Axis(resonance_hz=300.0, damping_ratio=0.1, creep=[slow])]), 50e-6)\n"
        f"h.run({LOOP})\n"
        "print(sorted({'control', 'matplotlib', 'scipy.signal', 'scipy.optimize'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_scenario_is_a_value_a_file_or_a_mapping(file):
    value = hammerstein.Scenario.model_validate(LOOP)
    reports = [hammerstein.run(given, "loop").to_json() for given in (value, file, str(file), LOOP)]
    assert len(set(reports)) == 1
    wires = [hammerstein.simulate(given).position_um for given in (value, file, LOOP)]
    assert all((wire == wires[0]).all() for wire in wires)
    assert hammerstein.run(file).name == "loop"


def test_a_signal_and_a_law_in_a_mapping_may_be_values():
    sine = hammerstein.Sine(amplitude=10.0, frequency_hz=50.0)
    assert hammerstein.run({**LOOP, "drive": sine}).to_json() == hammerstein.run(LOOP).to_json()

    def circle(reference, **law):
        rest = {key: value for key, value in LOOP.items() if key != "drive"}
        compensators = [{"label": "ours", "model": "duo_bimorph", **law}]
        return hammerstein.run({**rest, "reference": reference, "compensators": compensators}).to_json()

    values = (
        hammerstein.Circle(radius=10.0, frequency_hz=50.0),
        hammerstein.InverseMultiplicative(iterations=2),
    )
    words = {"kind": "circle", "radius_um": 10.0, "frequency_hz": 50.0}
    assert circle(values[0], law=values[1]) == circle(words, law="inverse_multiplicative", iterations=2)


def test_a_mistake_in_a_mapping_is_told_like_one_in_a_file():
    with pytest.raises(hammerstein.InputError, match=r"drive.amplitude_w.*did you mean amplitude_v"):
        hammerstein.run({**LOOP, "drive": {"kind": "sine", "amplitude_w": 10.0, "frequency_hz": 50.0}})


def test_check_of_files_and_values(file, tmp_path):
    assert hammerstein.check(file, tmp_path).findings != ()  # no baseline yet
    hammerstein.check(file, tmp_path, update=True)
    assert hammerstein.check(file, tmp_path).findings == ()
    assert hammerstein.check(LOOP, tmp_path / "loop.json").findings == ()
    other = {**LOOP, "drive": {"kind": "sine", "amplitude_v": 9.0, "frequency_hz": 50.0}}
    assert hammerstein.check(other, tmp_path / "loop.json").exit_code == 1
    with pytest.raises(hammerstein.InputError, match="give the file of its baseline"):
        hammerstein.check(LOOP)


def test_a_model_simulates_and_compensates_by_a_method():
    model = hammerstein.HammersteinModel.load("duo_bimorph")
    time_s = 50e-6 * np.arange(1000)
    path = 10.0 * np.stack([np.sin(2 * np.pi * 100 * time_s) ** 3, np.sin(2 * np.pi * 60 * time_s) ** 3])
    found = model.compensate(path)
    response = model.simulate(found.drive_v, 50e-6)
    np.testing.assert_array_equal(response.position_um, found.shortfall.predicted_um)
    assert np.abs(response.position_um - path).max() < 0.05  # steps of the converter, 1 mV, through 12 um/V
    same = model.compensate(path, law=hammerstein.HammersteinInverse())
    np.testing.assert_array_equal(same.drive_v, found.drive_v)
    with pytest.raises(hammerstein.InputError, match="pass softening_v to HammersteinInverse itself"):
        model.compensate(path, law=hammerstein.HammersteinInverse(), softening_v=0.1)
    with pytest.raises(hammerstein.InputError, match="did you mean softening_v"):
        model.compensate(path, softning_v=0.1)
    with pytest.raises(hammerstein.InputError, match=r"give \(2, samples\)"):
        model.simulate(np.zeros((3, 5)), 50e-6)


@pytest.mark.parametrize("name", ["duo_bimorph_paper", "asymmetric_stack", "rate_dependent_stack"])
def test_a_model_that_was_saved_and_loaded_is_equal(name, tmp_path):
    model = hammerstein.HammersteinModel.load(name)
    model.save(tmp_path / "model.json")
    loaded = hammerstein.HammersteinModel.load(tmp_path / "model.json")
    assert loaded == model
    assert hash(loaded) == hash(model)
    assert loaded.hysteresis == model.hysteresis
    assert loaded.dynamics.block() == model.dynamics.block()
    weights = [2.0 * np.asarray(w) for w in model.hysteresis.weights]
    assert loaded.hysteresis.with_weights(weights) != model.hysteresis
    assert replace(loaded, name="other") != model
    assert model != name


def test_a_fitted_model_is_equal_with_its_covariances(tmp_path):
    time_s = 1e-3 * np.arange(3000)
    u_v = 8.0 * np.sin(2.0 * np.pi * time_s)[None, :]
    pair = hammerstein.Pair([0.0, 1.3, 3.1], [2.0, 0.7, 0.4])
    y_um = hammerstein.PrandtlIshlinskii([[pair]]).respond(u_v)[0]
    y_um += 0.01 * np.random.default_rng(1).normal(size=y_um.shape)
    record = hammerstein.Record(u_v, y_um, 1e-3, ("u",), ("x",), "made")
    model, _ = hammerstein.identify([record], hammerstein.Settings(dynamics="none"))
    assert model.hysteresis.weight_covariance is not None
    model.save(tmp_path / "model.json")
    assert hammerstein.HammersteinModel.load(tmp_path / "model.json") == model


def test_bouc_wen_blocks_are_compared_too():
    a, b = (hammerstein.BoucWen([[hammerstein.BoucWenPair(2.0, d, 0.1, 0.05)]]) for d in (0.5, 0.6))
    assert a != b
    assert a == hammerstein.BoucWen(a.pairs)


def test_what_is_wrong_in_python_is_said_as_of_a_file():
    """One message in plain words with the nearest name, and no link to another project's pages."""
    with pytest.raises(hammerstein.InputError) as raised:
        hammerstein.Axis(resonanc_hz=3.0, delay_s=-1.0)
    said = str(raised.value)
    assert said.startswith("Axis: 2 mistakes")
    assert "did you mean resonance_hz?" in said
    assert "pydantic" not in said
