"""Whether two models are the same but for the last digits of their numbers.

Powers and cosines of NumPy differ by an ulp from one kind of processor to another, and with them a digest.
"""

from __future__ import annotations

import json
from typing import Any

import pytest

from hammerstein.model import HammersteinModel

ROUNDING = 1e-14


def assert_alike(one: HammersteinModel, other: HammersteinModel) -> None:
    """Compare everything that stands in the files of two models."""
    ours, theirs = (dict(_leaves(json.loads(model.to_json()))) for model in (one, other))
    assert ours.keys() == theirs.keys()
    for place, value in theirs.items():
        near = pytest.approx(value, rel=ROUNDING, abs=0.0) if isinstance(value, float) else value
        assert ours[place] == near, place


def _leaves(content: Any, path: str = "") -> Any:
    """Each value of a file with its place."""
    if isinstance(content, dict | list):
        inner = content.items() if isinstance(content, dict) else enumerate(content)
        for key, value in inner:
            yield from _leaves(value, f"{path}/{key}")
    else:
        yield path, content
