"""The long harness: twenty stages and two hundred actuators drawn at random, with the defaults only.

    python -m pytest tests/harness -s

It is not part of the ordinary tests, of which tests/test_first_command.py tries a few of the same.
"""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from made_up_cases import try_actuator, try_stage


def test_twenty_stages():
    found = [try_stage(seed) for seed in range(20)]
    for one in found:
        print(one)
    assert all(one.followed for one in found)
    assert all(one.resonances_fine for one in found)


def test_two_hundred_actuators():
    found = [try_actuator(seed) for seed in range(200)]
    ratios = np.array([one.ratio for one in found])
    print(
        f"at most 5 % worse than the best simpler one: {np.mean(ratios <= 1.05):.1%}; "
        f"worst {ratios.max():.3g}"
    )
    for one in sorted(found, key=lambda one: -one.ratio)[:10]:
        print(one)
    assert np.mean(ratios <= 1.05) >= 0.95
    assert ratios.max() <= 2.0
