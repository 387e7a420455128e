import json
import tracemalloc
from pathlib import Path

import pytest

from hammerstein.errors import InputError
from hammerstein.identification.settings import Settings
from hammerstein.scenario import Scenario, load_scenario
from hammerstein.scenario.source import JointFitSpec

GOOD = """
question = "How round is the circle?"
actuator = "duo_bimorph"
[reference]
kind = "circle"
radius_um = 50
frequency_hz = 50
[[compensators]]
label = "paper"
law = "inverse_multiplicative"
identification = { frequency_hz = 50 }
"""


def _load(tmp_path, text):
    path = tmp_path / "circle.toml"
    path.write_text(text)
    return load_scenario(path)


def test_values_arrive(tmp_path):
    scenario = _load(tmp_path, GOOD)
    assert scenario.reference.radius == 50.0
    assert scenario.compensators[0].identification.frequency_hz == 50.0
    assert [s.radius for s in scenario.signals()] == [50.0]


@pytest.mark.parametrize(
    ("old", "new", "messages"),
    [
        ("radius_um", "radus_um", ["reference.radus_um", "unknown key; did you mean radius_um?"]),
        ("radius_um = 50", "radius_um = -50", ["reference.radius_um", "must be 1e-6 to 1e6, not -50"]),
        ("radius_um = 50", 'radius_um = "wide"', ["reference.radius_um", "must be a number, not 'wide'"]),
        ("radius_um = 50", "radius_um = nan", ["reference.radius_um"]),
        ("frequency_hz = 50\n[[", "[[", ["reference.frequency_hz", "is missing"]),
        ('"circle"', '"cirle"', ["reference.kind", "did you mean circle?"]),
        (
            '"inverse_multiplicative"',
            '"inverse_multiplicativ"',
            ["compensators[1].law", "did you mean inverse_multiplicative?"],
        ),
        ('law = "inverse_multiplicative"\n', "", ["compensators[1].law", "is missing"]),
        (
            "{ frequency_hz = 50 }",
            "{ frequncy_hz = 50 }",
            ["compensators[1].identification.frequncy_hz", "did you mean"],
        ),
        ("identification = { frequency_hz = 50 }", "", ["give either identification or model"]),
        ("[reference]", "[drive]", ["drive.radius_um", "did you mean"]),
        ("[[compensators]]", "[[models]]", ["models[1].law", "unknown key"]),
        ("question =", 'title = "My stage"\nquestion =', ["title  unknown key"]),
        ("question", "questoin", ["questoin", "did you mean question?"]),
    ],
)
def test_mistakes_name_key_and_remedy(tmp_path, old, new, messages):
    assert old in GOOD
    with pytest.raises(InputError) as caught:
        _load(tmp_path, GOOD.replace(old, new, 1))
    for message in ("circle.toml", *messages):
        assert message in str(caught.value)


def test_all_mistakes_at_once(tmp_path):
    text = (
        GOOD.replace("radius_um", "radus_um").replace("question", "questoin").replace("= 50\n[[", "= -1\n[[")
    )
    with pytest.raises(InputError) as caught:
        _load(tmp_path, text)
    assert {m.where for m in caught.value.mistakes} == {  # a misspelt key is not missing, too
        "reference.radus_um",
        "questoin",
        "reference.frequency_hz",
    }


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (GOOD + GOOD.split("[[")[1].join(["[[", ""]), "used twice"),
        (GOOD + "[sweep]\namplitude_um = [1, 2]\n", "sweep.amplitude_um is not a key"),
        (GOOD + "[drive]\nkind = 'sine'\namplitude_v = 1\nfrequency_hz = 1\n", "either a table"),
        (GOOD.replace("[reference]", "[reference"), "not TOML"),
        ("", "is empty"),
    ],
)
def test_contradictions(tmp_path, text, message):
    with pytest.raises(InputError, match=message):
        _load(tmp_path, text)


def test_digest_follows_numbers_not_words_or_places(tmp_path):
    one = _load(tmp_path, GOOD)
    (tmp_path / "elsewhere").mkdir()
    other = _load(tmp_path / "elsewhere", GOOD.replace("How round", "Is it round: how"))
    assert one.digest() == other.digest()
    assert one.digest() != _load(tmp_path, GOOD.replace("radius_um = 50", "radius_um = 51")).digest()


def test_sweep_gives_every_combination(tmp_path):
    scenario = _load(tmp_path, GOOD + "[sweep]\nradius_um = [15, 30]\nfrequency_hz = [10, 20, 50]\n")
    pairs = [(s.radius, s.frequency_hz) for s in scenario.signals()]
    assert sorted(pairs) == [(r, f) for r in (15, 30) for f in (10, 20, 50)]


def test_infinite_ranges_survive_the_report(tmp_path):
    text = GOOD + "[instruments.drive]\nrange_v = inf\n[instruments.sensor]\nbandwidth_hz = inf\n"
    scenario = _load(tmp_path, text)
    assert Scenario.model_validate(json.loads(json.dumps(scenario.portable(), allow_nan=False))) == scenario


def test_digest_follows_what_the_files_hold(tmp_path):
    text = 'question = "?"\n[reference]\nkind = "file"\npath = "path.csv"\n'
    text += '[[compensators]]\nlabel = "none"\nlaw = "none"\nmodel = "duo_bimorph"\n'
    (tmp_path / "s.toml").write_text(text)
    digests = []
    for end in ("1", "2", "1"):
        (tmp_path / "path.csv").write_text(f"time_s,x,y\n0,0,0\n0.1,{end},0\n")
        digests.append(load_scenario(tmp_path / "s.toml").digest())
    assert digests[0] == digests[2] != digests[1]


@pytest.mark.parametrize(
    "text",
    [
        ".".join(["a"] * 500) + " = 1",
        ".".join(["a"] * 20_000) + " = 1",
        " . ".join(['"a b"', "'c.d'"] * 10_000) + " = 1",
        "[" + ".".join(["a"] * 20_000) + "]",
        "x = { " + ".".join(["a"] * 20_000) + " = 1 }",
        "x = " + "[" * 60 + "]" * 60,
    ],
)
def test_keys_without_end_are_no_scenario(tmp_path: Path, text: str) -> None:
    """They overflowed the stack; 20,000 parts took 1.6 GB in the reader of TOML itself."""
    path = tmp_path / "deep.toml"
    path.write_text('question = "How. far. does. a. sentence. go?"\n' + text + "\n")
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match="too deeply nested lists or tables"):
            load_scenario(path)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("option", ["operators", "creep_modes", "dead_zones"])
def test_a_scenario_takes_as_much_of_an_option_as_an_identification(option):
    def largest(accept):
        for number in range(1, 1000):
            try:
                accept({option: number})
            except (ValueError, InputError):
                return number - 1
        return None

    given = {"hysteresis": "asymmetric"} if option == "dead_zones" else {}
    taken = largest(lambda more: Settings(**given, **more))
    assert largest(lambda more: JointFitSpec(method="hammerstein", **given, **more)) == taken > 1
