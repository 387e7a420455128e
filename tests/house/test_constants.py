"""Every number by which the package decides says why it is so."""

import runpy
from pathlib import Path

import pytest

FOUND = runpy.run_path(str(Path(__file__).parents[2] / ".ci/constants.py"))

TEXT = '''
BARE = 3
OTHER = 2.0

# Of a block
FIRST = 1.0
SECOND, THIRD = 2, 3 * 4
BESIDE = -1.0  # beside

BELOW = 0.5
"""Below."""
words = 3
WORDS = "three"
'''


def test_a_reason_is_beside_below_or_above_the_block():
    found = {c.names: (c.value, c.reason) for c in FOUND["constants_of"](TEXT, "module.py")}
    assert found == {
        "BARE": ("3", ""),
        "OTHER": ("2.0", ""),
        "FIRST": ("1.0", "Of a block"),
        "SECOND, THIRD": ("(2, 3 * 4)", "Of a block"),
        "BESIDE": ("-1.0", "beside"),
        "BELOW": ("0.5", "Below."),
    }


@pytest.mark.full
def test_every_constant_has_a_reason():
    found = list(FOUND["constants"]())
    assert len(found) > 100
    assert [c for c in found if not c.reason] == []
