"""A short campaign; ``python -m tests.fuzz`` runs a long one."""

import random

import pytest
from hypothesis import HealthCheck, given, settings

from . import strategies
from .campaign import baseline_case, model_case, mutated, record_case, records, scenario_case, shipped

DRIVEN = {
    "question": "?",
    "actuator": "model.json",
    "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 50.0},
}
SHORT = {
    "derandomize": True,
    "database": None,
    "deadline": None,
    "suppress_health_check": list(HealthCheck),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(autouse=True)
def _quick_fits(monkeypatch):
    """No time for fits through the dynamics here; the long campaign has it."""
    monkeypatch.setattr("hammerstein.experiment.plan.SECONDS_OF_A_FIT", 1e3)


def test_scenarios(folder):
    seen = []

    @settings(max_examples=30, **SHORT)
    @given(strategies.scenarios())
    def campaign(content):
        seen.append(scenario_case(content, folder))

    campaign()
    assert {2} <= set(seen)


def test_models(folder):
    @settings(max_examples=25, **SHORT)
    @given(strategies.models())
    def campaign(content):
        model_case(content, folder)

    campaign()


def test_damaged_records(folder):
    draw, seeds = random.Random(3), records(folder)
    for _ in range(60):
        name, data, columns = draw.choice(seeds)
        record_case(mutated(data, draw), name.replace("seed", "case"), columns, folder)


def test_damaged_baselines_and_models(folder):
    draw, files = random.Random(4), dict(shipped())
    actuator = files["duo_bimorph.json"]
    for _ in range(8):
        baseline_case(mutated(files["static_inverse.json"], draw), folder)
    for _ in range(15):
        (folder / "model.json").write_bytes(mutated(actuator, draw))
        scenario_case(DRIVEN, folder)
