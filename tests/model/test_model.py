import json
from dataclasses import replace

import numpy as np
import pytest

from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import StaticDynamics
from hammerstein.errors import InputError
from hammerstein.hysteresis import Pair, PrandtlIshlinskii
from hammerstein.model import HammersteinModel


def _ragged():
    pairs = (
        (Pair([0.1, 1.0 / 3.0], [2.0, -0.5], [0.01, 0.02]), Pair.linear(0.2), Pair.absent()),
        (Pair.absent(), Pair([0.7], [1.0]), Pair([0.0, 2.0, 4.0], [1.0, 0.1, 0.2])),
    )
    return HammersteinModel(
        name="ragged",
        hysteresis=PrandtlIshlinskii(pairs),
        dynamics=StaticDynamics(n_outputs=2),
        amplitude_v=5.0,
        inputs=("a", "b", "c"),
        outputs=("x", "y"),
        provenance={"from": "a test"},
    )


def test_file_keeps_every_bit(tmp_path):
    model = _ragged()
    model.save(tmp_path / "model.json")
    again = HammersteinModel.load(tmp_path / "model.json")
    assert again.to_json() == model.to_json()
    assert again.digest() == model.digest()
    for row, same in zip(model.hysteresis.pairs, again.hysteresis.pairs, strict=True):
        for pair, copy in zip(row, same, strict=True):
            np.testing.assert_array_equal(pair.thresholds_v, copy.thresholds_v)
            np.testing.assert_array_equal(pair.weights_um_per_v, copy.weights_um_per_v)


def test_a_drive_of_no_stated_range_reaches_what_was_recorded(tmp_path):
    """The default is the paper's converter of 10 V: a stack known from 0 to 100 V had no start inside it."""
    known = {"amplitude_v": 50.0, "voltages": Voltages.of([50.0] * 3, [0.0] * 3, [100.0, 100.0, 60.0])}
    model = replace(_ragged(), **known)
    assert model.instruments.drive.range_v == ((0.0, 100.0), (0.0, 100.0), (0.0, 60.0))
    model.save(tmp_path / "model.json")
    assert HammersteinModel.load(tmp_path / "model.json").instruments == model.instruments
    stated = replace(_ragged(), instruments=Instruments(drive=Drive(range_v=(-10.0, 10.0))), **known)
    assert stated.instruments.drive.range_v == (-10.0, 10.0)
    assert _ragged().instruments == Instruments()


def test_digest_follows_the_numbers_and_not_the_words():
    model = _ragged()
    content = json.loads(model.to_json())
    content["name"] = "another"
    content["hysteresis"]["pairs"][0][1]["weights_um_per_v"] = [0.3]
    assert model.digest() != _digest(content)
    content["hysteresis"]["pairs"][0][1]["weights_um_per_v"] = [0.2]
    assert model.digest() == _digest(content)


def _digest(content):
    from hammerstein.model import ModelFile

    return ModelFile.model_validate_json(json.dumps(content)).model().digest()


def _written(tmp_path, change):
    content = json.loads(_ragged().to_json())
    change(content)
    path = tmp_path / "model.json"
    path.write_text(json.dumps(content))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(nmae="x"), "unknown key; did you mean name"),
        (lambda c: c.pop("amplitude_v"), "amplitude_v is missing|amplitude_v +is missing"),
        (lambda c: c.update(inputs=["a"]), "names 1 inputs of 3"),
        (lambda c: c["hysteresis"]["pairs"][0][0].update(thresholds_v=[1.0, 0.5]), "not strictly increasing"),
        (lambda c: c["hysteresis"]["pairs"][0][0].update(thresholds_v=[-1.0, 0.5]), "must be 0 to 1e6"),
        (lambda c: c["hysteresis"]["pairs"][0][0].update(thresholds_v=[float("nan"), 0.5]), "1e6, not nan"),
        (lambda c: c["hysteresis"]["pairs"][1][1].update(weights_um_per_v=[1.0, 2.0]), "has shape"),
        (lambda c: c["hysteresis"]["pairs"].pop(), "must have 1 inputs and 1 outputs"),
        (lambda c: c["hysteresis"]["pairs"][0].pop(), "must hold one pair for each input of each output"),
        (lambda c: c.update(format="other/2"), "hammerstein-model/2"),
        (lambda c: c["dynamics"].update(kind="axis"), "did you mean axes"),
    ],
)
def test_wrong_files_say_what_is_wrong(tmp_path, change, message):
    path = _written(tmp_path, change)
    with pytest.raises(InputError, match=message) as caught:
        HammersteinModel.load(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"{", "not JSON"),
        (b"{\n\xff\xfe\x00", "row 2 is not UTF-8"),
        (None, "no such file"),
    ],
)
def test_unreadable_files(tmp_path, content, message):
    path = tmp_path / "model.json"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        HammersteinModel.load(path)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "model.json"
    with path.open("wb") as file:
        file.truncate(100_000_000)
    with pytest.raises(InputError, match="100 MB, too large"):
        HammersteinModel.load(path)


def test_unwritable_place_leaves_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        _ragged().save(tmp_path / "file" / "model.json")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("name", "bandwidths"), [("duo_bimorph", (430.0, 470.0)), ("duo_bimorph_resonant", (657, 718))]
)
def test_bandwidth_of_the_packaged_actuators(name, bandwidths):
    import control

    system = HammersteinModel.load(name).dynamics.system()
    for axis, wanted in enumerate(bandwidths):
        assert control.bandwidth(system[axis, axis]) / (2 * np.pi) == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize("name", ["stage.jsn", "stage", "stge.json"])
def test_a_name_near_that_of_a_model_file_is_answered_with_it(name, tmp_path):
    _ragged().save(tmp_path / "stage.json")
    with pytest.raises(InputError, match=r"did you mean .*stage\.json\?"):
        HammersteinModel.load(tmp_path / name)
