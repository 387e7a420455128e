from pathlib import Path

import numpy as np
import pytest
from record_cases import TIME, U, X, table_text


def pytest_configure(config: pytest.Config) -> None:
    """Make a warning an error where a module of the tests raises it, not where a library does."""
    modules = sorted(path.stem for path in Path(__file__).parent.rglob("*.py"))
    config.addinivalue_line("filterwarnings", f"error:::({'|'.join(modules)})$")


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Keep results of identifications for this run of the tests only, and no results of runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAMMERSTEIN_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setenv("HAMMERSTEIN_CACHE_MB", "0")
        yield


@pytest.fixture
def table():
    """Time, voltage and displacement of a loop (sample, column)."""
    return np.column_stack([TIME, U, X])


@pytest.fixture
def csv(tmp_path, table):
    """Write lines of a CSV file, changed by the caller, and return its path."""

    def write(change=lambda lines: None, name="loop.csv"):
        lines = ["t,u_x,x", *table_text(table).splitlines()]
        change(lines)
        path = tmp_path / name
        path.write_text("\n".join(lines) + "\n")
        return path

    return write
