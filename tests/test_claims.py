import math

import pytest
from pydantic import ValidationError

from hammerstein.errors import InputError
from hammerstein.metrics import Row
from hammerstein.scenario.claims import Agreement, Claim, Quantity, verdicts


def _row(rms, frequency=50.0, measured="x", true=None, label="a"):
    figures = {"rms_um": rms} | ({} if true is None else {"rms_true_um": true})
    return Row(label, "x", measured, frequency, amplitude_v=10.0, figures=figures)


ROWS = (_row(1.0, 10), _row(2.0, 50), _row(8.0, 200), _row(5.0, 50, "y"), _row(3.0, 50, label="b"))


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ({"compensator": "a", "measured_axis": "x", "frequency_hz": 50}, 2.0),
        ({"compensator": "a", "measured_axis": "x"}, 8.0),
        ({"measured_axis": "x", "of": "min"}, 1.0),
        ({"compensator": "a", "measured_axis": "x", "to_hz": 50, "of": "mean"}, 1.5),
        ({"compensator": "a", "measured_axis": "x", "from_hz": 50, "of": "spread"}, 4.0),
    ],
)
def test_quantity_selects_and_reduces(selection, expected):
    assert Quantity(metric="rms_um", **selection).value(ROWS) == expected


def _claim(agreement, paper=None, **fields):
    return Claim.model_validate(
        {
            "id": "C0",
            "statement": "s",
            "paper": paper,
            "quantity": {"metric": "rms_um", "compensator": "a", "measured_axis": "x", "frequency_hz": 200},
            "agreement": agreement,
        }
        | fields
    )


def test_value_is_a_scaled_ratio():
    claim = _claim({"at_most": 1}, factor=0.5, over={"metric": "rms_um", "compensator": "b"})
    assert claim.value(ROWS) == pytest.approx(0.5 * 8.0 / 3.0)


@pytest.mark.parametrize(
    ("agreement", "value", "paper", "holds"),
    [
        ({"within": 0.1}, 1.09, 1.0, True),
        ({"within": 0.1}, 1.11, 1.0, False),
        ({"within": 0.1}, -1.09, -1.0, True),
        ({"at_most": 2.0}, 2.0, None, True),
        ({"at_most": 2.0}, 2.1, None, False),
        ({"at_least": 2.0, "at_most": 3.0}, 1.9, None, False),
        ({"at_least": 2.0}, math.nan, None, False),
    ],
)
def test_agreement(agreement, value, paper, holds):
    assert Agreement(**agreement).holds(value, paper) is holds


def test_verdict_names_the_measured_cause():
    claim = _claim({"at_most": 2.0}, paper=4.0)
    rows = {"plant": (_row(8.0, 200, true=7.0),), "still": (_row(1.5, 200, true=1.2),)}
    (verdict,) = verdicts([claim], rows, static="still")
    assert not verdict.agrees
    assert verdict.ratio == 2.0
    assert [a.value for a in verdict.answers] == [8.0, 1.5]
    assert verdict.reason == "the dynamics: at the true position 7, without dynamics 1.5, without both 1.2"


def test_verdict_of_the_sensor():
    rows = {"plant": (_row(8.0, 200, true=1.0),), "still": (_row(8.0, 200, true=1.0),)}
    (verdict,) = verdicts([_claim({"at_most": 2.0})], rows, static="still")
    assert verdict.reason.startswith("the sensor's lag and noise: at the true position 1")


def test_met_claims_need_no_reason():
    (verdict,) = verdicts([_claim({"at_most": 9.0})], {"plant": ROWS})
    assert verdict.agrees
    assert verdict.reason == ""
    assert verdict.as_dict()["verdict"] == "met"


def test_a_claim_that_selects_nothing_is_a_mistake():
    claim = _claim({"at_most": 1}, quantity={"metric": "rms_um", "compensator": "c"})
    with pytest.raises(InputError, match="selects no row"):
        verdicts([claim], {"plant": ROWS})


@pytest.mark.parametrize(
    "fields", [{"agreement": {}}, {"agreement": {"within": 0.1}}, {"quantity": {"metric": "rms"}}]
)
def test_refused(fields):
    with pytest.raises(ValidationError):
        _claim(
            fields.get("agreement", {"at_most": 1}), **{k: v for k, v in fields.items() if k != "agreement"}
        )
