"""Every number that a file may hold has limits, in message and schema, and every key says what it is."""

import json
import subprocess
import sys

import numpy as np
import pytest
from pydantic import ValidationError

from hammerstein.blocks.instruments import Drive, Sensor
from hammerstein.commands.start import guide_pages
from hammerstein.errors import InputError
from hammerstein.model import ModelFile
from hammerstein.quantities import BANDWIDTH_HZ, FREQUENCY_HZ
from hammerstein.scenario import Scenario, load_scenario
from hammerstein.signals import SIGNALS


def _numbers(node, path=""):
    """Every number of a JSON schema, with its place."""
    if isinstance(node, dict):
        if node.get("type") in ("number", "integer"):
            yield path, node
        for key, value in node.items():
            yield from _numbers(value, f"{path}/{key}")
    elif isinstance(node, list):
        for i, value in enumerate(node):
            yield from _numbers(value, f"{path}/{i}")


@pytest.mark.parametrize("model", [Scenario, ModelFile])
def test_every_number_in_every_schema_has_limits(model):
    off = ("range_v", "range_um", "bandwidth_hz")  # infinity switches these off
    free = [
        path
        for path, node in _numbers(model.model_json_schema())
        if not {"minimum", "maximum"} <= set(node) and not any(name in path for name in off)
    ]
    assert free == []


def test_only_what_can_be_switched_off_may_be_infinite():
    assert BANDWIDTH_HZ.holds(float("inf"))
    assert not BANDWIDTH_HZ.holds(float("-inf"))
    assert not FREQUENCY_HZ.holds(float("inf"))
    assert not FREQUENCY_HZ.holds(float("nan"))


@pytest.mark.parametrize("resolution", [0.0, 1e-12, 0.04])
def test_a_resolution_is_none_or_one_that_numbers_have(resolution):
    assert Sensor(resolution_um=resolution, noise_um=0.0).read(
        np.full((1, 1), 20.0), np.random.default_rng(0)
    ) == pytest.approx(20)
    for finer in (5e-324, 1e-300, 1e-13):
        with pytest.raises(InputError, match="must be 0, or 1e-12 to 1e6"):
            Sensor(resolution_um=finer)
        with pytest.raises(InputError, match="must be 0, or 1e-12 to 1e6"):
            Drive(resolution_v=finer)


BASE = """
question = "?"
[reference]
kind = "sine"
amplitude_um = 10
frequency_hz = 50
[[compensators]]
label = "paper"
law = "hammerstein_inverse"
model = "duo_bimorph"
[uncertainty]
draws = 2
[assessment]
kind = "paper"
[[assessment.claims]]
id = "a"
statement = "b"
quantity = { metric = "rms_um" }
agreement = { at_most = 1 }
"""


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("amplitude_um = 10", "amplitude_um = inf", "reference.amplitude_um"),
        ("amplitude_um = 10", "amplitude_um = 10\noffset_um = -inf", "reference.offset_um"),
        ("frequency_hz = 50", "frequency_hz = 1e-320", "reference.frequency_hz"),
        ("frequency_hz = 50", "frequency_hz = 50\nsmooth_start_s = 5e-324", "reference.smooth_start_s"),
        ("draws = 2", "resonance = 1.7e308", "uncertainty.resonance"),
        ("agreement", "paper = -inf\nagreement", "assessment.claims[1].paper"),
        ('model = "duo', 'preview_s = inf\nmodel = "duo', "compensators[1].preview_s"),
        ('model = "duo', 'filter_hz = nan\nmodel = "duo', "compensators[1].filter_hz"),
        ("draws = 2", "seed = 100000000000000000000000000", "uncertainty.seed"),
        ("[reference]", "seed = -1\n[reference]", "seed"),
        (
            "[uncertainty]",
            "[instruments.drive]\nsample_time_s = 0.0\n[uncertainty]",
            "instruments.drive.sample_time_s",
        ),
        (
            "[uncertainty]",
            "[instruments.drive]\nsample_time_s = 1e-12\n[uncertainty]",
            "instruments.drive.sample_time_s",
        ),
    ],
)
def test_a_number_beyond_its_physics_is_refused_with_its_limits(tmp_path, old, new, where):

    assert old in BASE
    path = tmp_path / "s.toml"
    path.write_text(BASE.replace(old, new, 1))
    with pytest.raises(InputError) as caught:
        load_scenario(path)
    mistakes = {mistake.where: mistake.what for mistake in caught.value.mistakes}
    assert list(mistakes) == [where]
    assert mistakes[where].startswith("must be ")
    assert " to " in mistakes[where]


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 5000,
        "a = " + "9" * 5000,
        'actuator = "duo\\u0000bimorph.json"',
        'actuator = "' + "n" * 3000 + '.json"',
    ],
)
def test_files_that_no_parser_likes_are_one_message(tmp_path, text):

    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"s\.toml"):
        load_scenario(path)


def test_the_same_limits_hold_in_python():
    with pytest.raises(ValidationError, match="must be 0 to 1"):
        Scenario.model_validate(
            {
                "question": "?",
                "drive": {"kind": "sine", "amplitude_v": 1, "frequency_hz": 1},
                "uncertainty": {"noise": 2},
            }
        )


def test_every_key_of_a_scenario_is_described():
    command = (sys.executable, "-m", "hammerstein", "schema")  # here, other tests register laws of their own
    schema = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    bare = [
        (table, key)
        for table, part in {"": schema, **schema["$defs"]}.items()
        for key, node in part.get("properties", {}).items()
        if not node.get("description") and "const" not in node
    ]
    assert bare == []


@pytest.mark.parametrize("name", SIGNALS.kinds)
def test_the_guide_names_every_key_of_every_signal(name):
    page = guide_pages()["signals"].read_text()
    (row,) = [line for line in page.splitlines() if line.startswith(f"| `{name}` |")]
    for key in SIGNALS.kinds[name].model_fields:
        inked = f"`{key}_um`" if key in ("amplitude", "radius", "offset") else f"`{key}`"
        assert inked in page if key in ("kind", "offset", "smooth_start_s") else inked in row
