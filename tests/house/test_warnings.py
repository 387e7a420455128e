"""A warning is an error where it is ours, and none where it is a library's own."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
WARNS = "import warnings\ndef old(levels=1): warnings.warn('old', DeprecationWarning, stacklevel=levels)\n"


def module(name: str, source: str) -> dict[str, object]:
    """What a module of this name holds."""
    names: dict[str, object] = {"__name__": name}
    exec(source, names)
    return names


@pytest.mark.parametrize(
    "name", ["hammerstein", "hammerstein.runtime.store", *sorted(path.stem for path in TESTS.rglob("*.py"))]
)
def test_a_warning_of_ours_is_an_error(name: str) -> None:
    with pytest.raises(DeprecationWarning):
        module(name, f"{WARNS}old()")


def test_so_is_one_that_a_library_raises_where_we_call_it() -> None:
    with pytest.raises(DeprecationWarning):
        module("library", WARNS)["old"](2)  # type: ignore[operator]


@pytest.mark.parametrize("category", [DeprecationWarning, FutureWarning, RuntimeWarning, UserWarning])
@pytest.mark.parametrize("name", ["library", "test", "scipy.signal", "numpy.testing"])
def test_a_warning_of_a_library_is_none(name: str, category: type[Warning]) -> None:
    with warnings.catch_warnings(record=True) as caught:
        module(name, f"import warnings\nwarnings.warn('its own', {category.__name__})")
    assert [warning.category for warning in caught] == [category]
