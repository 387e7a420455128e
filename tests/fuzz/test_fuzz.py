"""A short campaign; ``python -m tests.fuzz`` runs a long one."""

import random

import pytest
from hypothesis import HealthCheck, given, settings

from . import hostile, options, strategies
from .__main__ import class_of
from .campaign import (
    baseline_case,
    good_baseline,
    model_case,
    model_file_case,
    mutated,
    option_case,
    path_bytes,
    path_case,
    record_case,
    records,
    scenario_case,
    shipped,
)

SHORT = {
    "derandomize": True,
    "database": None,
    "deadline": None,
    "suppress_health_check": list(HealthCheck),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


@pytest.mark.parametrize(
    ("found", "name"),
    [
        ("KeyError: 'a'", "traceback"),
        ("FindingError: ('run',): exit code 70\nhammerstein: internal error", "internal error"),
        ("the process ended with -11", "signal"),
        ("large: 2.1 GB resident", "memory"),
        ("slow: not done after 61 s of the processor", "hang"),
        ("FindingError: ('show',): warns overflow in kernel.py:3", "warning shown"),
        ("FindingError: ['run', 'a']: nonsense number in a.md: inf", "nonsense number"),
        ("FindingError: ['run', 'a']: raw markup in a.md", "raw markup"),
        ("FindingError: ('show', 'warns a.csv'): exit code 2 names none of ('a',)", "other"),
    ],
)
def test_a_finding_has_one_class(found, name):
    assert class_of(found) == name


@pytest.fixture
def times(request):
    """Factor of the number of cases."""
    return 5 if request.config.getoption("--full") else 2


@pytest.fixture(autouse=True)
def _quick_fits(monkeypatch):
    """No time for fits through the dynamics here; the long campaign has it."""
    monkeypatch.setattr("hammerstein.experiment.plan.SECONDS_OF_A_FIT", 1e3)


def test_scenarios(folder, times):
    seen = []

    @settings(max_examples=4 * times, **SHORT)
    @given(strategies.scenarios())
    def campaign(content):
        seen.append(scenario_case(content, folder))

    campaign()
    assert {2} <= set(seen)


def test_models(folder, times):
    seen = []

    @settings(max_examples=5 * times, **SHORT)
    @given(strategies.models())
    def campaign(content):
        seen.append(model_case(content, folder))

    campaign()
    assert {2} <= set(seen)


def test_command_lines(folder, times):
    seen = []

    @settings(max_examples=3 * times, **SHORT)
    @given(options.command_lines())
    def campaign(line):
        seen.append(option_case(line, folder))

    campaign()
    assert 2 in seen
    assert option_case(["show", "duo_bimorph"], folder) == 0


@pytest.mark.full
def test_damaged_records(folder, times):
    draw, seeds = random.Random(3), records(folder)
    for i in range(4 * times):
        name, data, columns = draw.choice(seeds)
        record_case(mutated(data, draw), name.replace("seed", "case"), columns, folder, fitted=i % 10 == 0)
        path_case(mutated(path_bytes(), draw), folder)


def test_damaged_baselines_and_models(folder, times):
    draw, actuator = random.Random(4), dict(shipped())["duo_bimorph.json"]
    own = good_baseline(folder)
    assert [baseline_case(mutated(own, draw), folder) for _ in range(8)].count(2) > 2
    for _ in range(3 * times):
        model_file_case(mutated(actuator, draw), folder)


@pytest.mark.full
def test_hostile_files(tmp_path):
    """300 files whose names and values are hostile together, each read by a command."""
    seeds, seen = hostile.Seeds(tmp_path), []
    for number in range(300):
        seen.append(hostile.case(random.Random(f"short {number}"), seeds, tmp_path))
    assert {0, 2} <= set(seen)
    assert seen.count(0) > 30
