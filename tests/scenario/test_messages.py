"""What a person reads of a mistake in a file: where it stands, what is wrong, what to do."""

import json

import pytest

from hammerstein.errors import InputError
from hammerstein.model import HammersteinModel
from hammerstein.scenario import load_scenario

SINE = """
question = "How far off is a sine?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[measure]
settle_cycles = 2
[[compensators]]
label = "paper"
law = "inverse_multiplicative"
identification = { frequency_hz = 50 }
[[compensators]]
label = "none"
law = "none"
model = "duo_bimorph"
"""


def _mistakes(tmp_path, old, new):
    assert old in SINE
    path = tmp_path / "sine.toml"
    path.write_text(SINE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    return {mistake.where: mistake.what for mistake in caught.value.mistakes}


@pytest.mark.parametrize(
    ("old", "new", "where", "what"),
    [
        (
            "settle_cycles = 2",
            "phase_deg = 2",
            "measure.phase_deg",
            "unknown key here; it belongs to reference or drive",
        ),
        (
            "amplitude_um = 10",
            "amplitude_um = 10\ntrigger_s = 1",
            "reference.trigger_s",
            "unknown key of sine; it belongs to spiral",
        ),
        ('model = "duo_bimorph"', "", "compensators[2]", "give either identification or model"),
        (
            'law = "none"',
            'law = "none"\niterations = 3',
            "compensators[2].iterations",
            "unknown key of none; it belongs to inverse_multiplicative",
        ),
        (
            'law = "none"',
            'law = "inverse_multiplicative"\ngain = 5',
            "compensators[2].gain",
            "must be 'identity' or 'auto' or a list, not 5",
        ),
        (
            'law = "none"',
            'law = "inverse_multiplicative"\ngain = [[1.0, 2.0], [3.0]]',
            "compensators[2].gain",
            "has rows of different lengths",
        ),
        ("amplitude_um = 10", "amplitude_um = 10\naxis = 'x'", "reference.axis", "a whole number or 'each'"),
        (
            "[measure]",
            "[tolerances]\nrelative = 1e-3\n[measure]",
            "tolerances.relative",
            "[tolerances.rms_um]",
        ),
        ("[measure]", "[tolerances.rms]\nrelative = 1\n[measure]", "tolerances.rms", "did you mean rms_um?"),
        (
            "frequency_hz = 50 }",
            "frequency_hz = 50, frequencies_hz = [5] }",
            "compensators[1].identification.frequencies_hz",
            "did you mean frequency_hz?",
        ),
        (
            "frequency_hz = 50\n",
            "frequency_hz = inf\n",
            "reference.frequency_hz",
            "must be 1e-6 to 1e8, not inf",
        ),
        (
            "settle_cycles = 2",
            "settle_cycles = 2.5",
            "measure.settle_cycles",
            "must be a whole number, not 2.5",
        ),
    ],
)
def test_a_mistake_says_where_the_key_belongs(tmp_path, old, new, where, what):
    mistakes = _mistakes(tmp_path, old, new)
    assert list(mistakes) == [where]
    assert what in mistakes[where]


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        (
            'kind = "sine"\namplitude_um = 10\nfrequency_hz = 50',
            'kind = "sime"\namplitude_um = -10\nfrequenci_hz = 50',
            {"reference.kind", "reference.amplitude_um", "reference.frequenci_hz"},
        ),
        (
            'law = "none"',
            'law = "inverse_multiplicativ"\niteratons = 3',
            {"compensators[2].law", "compensators[2].iteratons"},
        ),
        ('kind = "sine"\namplitude_um = 10', 'kind = "zzz"\namplitude_um = -10', {"reference.kind"}),
        (
            'kind = "sine"\namplitude_um = 10',
            'knid = "sine"\namplitude_um = -10',
            {"reference.kind", "reference.amplitude_um"},
        ),
    ],
)
def test_a_misspelt_kind_hides_no_other_mistake(tmp_path, old, new, wanted):
    """The other keys of its table are judged as those of the nearest kind; where none is near, they wait."""
    assert set(_mistakes(tmp_path, old, new)) == wanted


def test_a_misspelt_key_of_a_kind_is_named(tmp_path):
    path = tmp_path / "sine.toml"
    path.write_text(SINE.replace('kind = "sine"', 'knid = "sine"'))
    with pytest.raises(InputError, match=r"reference\.kind  is missing; is knid meant for it\?"):
        load_scenario(path)


def test_a_misspelt_actuator_stands_with_the_other_mistakes(tmp_path):
    path = tmp_path / "sine.toml"
    path.write_text(
        SINE.replace("[reference]", 'actuator = "duo_bimorf"\n[reference]').replace("question", "questoin")
    )
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    mistakes = {mistake.where: mistake.what for mistake in caught.value.mistakes}
    assert set(mistakes) == {"actuator", "questoin"}
    assert "did you mean duo_bimorph?" in mistakes["actuator"]


@pytest.mark.parametrize("place", ["model", "also_on"])
def test_other_misspelt_models_stand_there_too(tmp_path, place):
    new = {
        "model": ('model = "duo_bimorph"', 'model = "duo_bimorf"'),
        "also_on": (
            "[reference]",
            '[assessment]\nkind = "paper"\nalso_on = [{ actuator = "duo_bimorf" }]\n[reference]',
        ),
    }[place]
    mistakes = _mistakes(tmp_path, *new)
    where = {"model": "compensators[2].model", "also_on": "assessment.also_on[1].actuator"}[place]
    assert "did you mean duo_bimorph?" in mistakes[where]


def test_a_model_file_with_a_key_twice_is_refused(tmp_path):
    """The last of them was taken, whatever a person had edited."""
    file = tmp_path / "twice.json"
    text = HammersteinModel.load("duo_bimorph").to_json()
    file.write_text(text.replace('"damping_ratio": 0.12,', '"damping_ratio": 0.12, "damping_ratio": 0.1,', 1))
    with pytest.raises(
        InputError, match=r"twice\.json: contains the key 'damping_ratio' twice in one object"
    ):
        HammersteinModel.load(file)


def test_json_in_place_of_a_scenario_is_named_for_what_it_is(tmp_path):
    """The message was one on the grammar of TOML."""
    file = tmp_path / "model.json"
    HammersteinModel.load("duo_bimorph").save(file)
    with pytest.raises(InputError, match=r"is the file of a model; .* a scenario \(\.toml\) was expected"):
        load_scenario(file)
    file.write_text('{"gain": 3}')
    with pytest.raises(InputError, match=r"is JSON; a scenario \(\.toml\) was expected"):
        load_scenario(file)


def test_a_model_file_names_the_pair(tmp_path):
    model = json.loads(HammersteinModel.load("duo_bimorph").to_json())
    model["hysteresis"]["pairs"][0][1]["weights_um_per_v"][2] = 1e300
    model["dynamics"]["axes"][1]["resonance"] = 5.0
    path = tmp_path / "model.json"
    path.write_text(json.dumps(model))
    with pytest.raises(InputError) as caught:
        HammersteinModel.load(path)
    mistakes = {mistake.where: mistake.what for mistake in caught.value.mistakes}
    assert "must be -1e9 to 1e9, not 1e+300" in mistakes["hysteresis.pairs[1][2].weights_um_per_v[3]"]
    assert "did you mean resonance_hz?" in mistakes["dynamics.axes[2].resonance"]


@pytest.mark.parametrize(
    ("change", "where", "what"),
    [
        (
            lambda pairs: pairs[0].pop(),
            "hysteresis",
            "pairs must hold one pair for each input of each output",
        ),
        (lambda pairs: pairs.pop(), "outputs", "names 2 outputs of 1"),
    ],
)
def test_a_model_file_with_pairs_that_do_not_fit_names_the_key(tmp_path, change, where, what):
    model = json.loads(HammersteinModel.load("duo_bimorph").to_json())
    model["hysteresis"].pop("weight_covariance", None)
    change(model["hysteresis"]["pairs"])
    with pytest.raises(InputError) as caught:
        HammersteinModel.from_json(json.dumps(model))
    assert {m.where: m.what for m in caught.value.mistakes}[where] == what


def test_a_mistake_in_an_option_names_the_option(tmp_path, capsys, csv):
    """``identify --creep-modes 9`` once spoke of creep_modes, of no option and of no file."""
    from hammerstein.commands.cli import main

    columns = ["--inputs", "u_x", "--outputs", "x", "--rate", "1000", "--out", str(tmp_path / "m.json")]
    options = ["--creep-modes", "9", "--dynamics", "second_order", "--sensor-bandwidth", "nan"]
    for more, told in (
        (options, ("--creep-modes", "must be 0 to 5 or 'auto', not '9'")),
        (options, ("--sensor-bandwidth", "must be")),
        (["--sensor-delay", "-1e-5"], ("--sensor-delay", "must be 0 to 10000")),
        (["--operators", "x"], ("--operators", "must be a whole number or 'auto', not 'x'")),
        (["--operators", "-3"], ("--operators", "must be 1 to 200 or 'auto', not '-3'")),
        (["--thresholds", "x"], ("--thresholds", "'x' is not a list of voltages")),
        (["--thresholds", "3,1"], ("--thresholds", "each larger than the previous one")),
        (["--thresholds", "0,nan"], ("--thresholds", "must be 0 to 1e6")),
    ):
        with pytest.raises(SystemExit) as caught:
            main(["identify", str(csv()), *columns, *more])
        said = capsys.readouterr().err
        assert caught.value.code == 2
        assert all(words in said for words in told)


PAIR = {"direct_um_per_v": 5.0, "hysteretic_um_per_v": 1.0, "beta_per_v": 0.3, "gamma_per_v": 0.1}
PLAYS = {"thresholds_v": [0.0, 1.0], "growth_s": [0.0], "bandwidth_hz": 100.0}


@pytest.mark.parametrize(
    ("hysteresis", "told"),
    [
        (
            {"kind": "bouc_wen", "pairs": [[PAIR, PAIR | {"beta_per_v": -1.0}]] * 2},
            "hysteresis.pairs[1][2]  beta",
        ),
        ({"kind": "bouc_wen", "pairs": [[]]}, "hysteresis  must have a row for each output"),
        (
            {"kind": "rate_dependent", "inputs": [PLAYS, PLAYS], "weights_um_per_v": [[[1.0]]]},
            "hysteresis.inputs[2]  growth_s has shape",
        ),
        (
            {"kind": "parallel", "parts": [{"kind": "bouc_wen", "pairs": [[PAIR] * n] * 2} for n in (1, 2)]},
            "hysteresis  needs two parts or more with the same inputs and outputs",
        ),
    ],
)
def test_what_cannot_be_built_of_a_kind_names_its_place(hysteresis, told):
    model = json.loads(HammersteinModel.load("duo_bimorph_static").to_json()) | {"hysteresis": hysteresis}
    with pytest.raises(InputError) as refused:
        HammersteinModel.from_json(json.dumps(model), "m.json")
    assert told in str(refused.value)
    assert str(refused.value).startswith("m.json")
