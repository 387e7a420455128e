"""The long harness: twenty stages and two hundred actuators drawn at random, with the defaults only.

    python tests/harness/test_harness.py stages 0 20
    python tests/harness/test_harness.py actuators 0 25

tries a part of them, one line each, and tells the rates; ``pytest tests/harness`` tries all and asserts. It
is not part of the ordinary tests, of which tests/commands/test_first_command.py tries a few of the same.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from made_up_cases import try_actuator, try_stage


def stage_rates(found):
    return {name: np.mean([getattr(one, name) for one in found]) for name in STAGE}


def actuator_rates(found):
    ratios = np.array([one.ratio for one in found])
    played = [one.played for one in found if one.played is not None]
    return {
        "at most 5 % worse than the best simpler one": np.mean(ratios <= 1.05),
        "worst ratio": ratios.max(),
        "drives within three times the error": np.mean(played) if played else np.nan,
        "drives refused": np.mean([one.played is None for one in found]),
    }


STAGE = ("followed", "resonances_fine", "drawn")
KINDS = {"stages": (try_stage, stage_rates), "actuators": (try_actuator, actuator_rates)}


def tried(kind, first, last):
    attempt, rates = KINDS[kind]
    found = []
    for seed in range(first, last):
        found.append(attempt(seed))
        print(found[-1], flush=True)
    print(kind, first, last, {name: round(float(value), 3) for name, value in rates(found).items()})
    return rates(found)


def test_twenty_stages():
    assert min(tried("stages", 0, 20).values()) == 1.0


def test_two_hundred_actuators():
    found = tried("actuators", 0, 200)
    assert found["at most 5 % worse than the best simpler one"] >= 0.95
    assert found["worst ratio"] <= 2.0
    assert found["drives within three times the error"] == 1.0


if __name__ == "__main__":
    tried(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
