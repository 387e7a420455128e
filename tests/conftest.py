import gc
import os
import signal
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from record_cases import TIME, U, X, table_text

from hammerstein.runtime.resources import keep_freed_memory

keep_freed_memory()
hypothesis.settings.register_profile("untimed", deadline=None)  # a loop may have to be compiled first
hypothesis.settings.load_profile("untimed")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that runs what is slow by design, too."""
    parser.addoption("--full", action="store_true", help="run what is slow by design, too")


def pytest_configure(config: pytest.Config) -> None:
    """Make a warning an error where a module of the tests raises it, not where a library does."""
    modules = sorted(path.stem for path in Path(__file__).parent.rglob("*.py"))
    config.addinivalue_line("markers", "full: slow by design; runs with --full")
    config.addinivalue_line("markers", "long: runs only where HAMMERSTEIN_LONG is set")
    config.addinivalue_line("filterwarnings", f"error:::({'|'.join(modules)})$")
    if not entry_points(group="hammerstein.blocks", name="paper"):
        pytest.exit("the installed package is an older one; run python -m pip install -e . --no-deps", 4)
    # Behind a shell's "&" Ctrl-C is ignored, and programs that are begun here would inherit that.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Search for no garbage meanwhile, and later not among what was collected: it stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


LONG = "takes long; HAMMERSTEIN_LONG=1 runs it, as the weekly workflow does"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what takes long, unless it is asked for."""
    if not config.getoption("--full"):
        for item in items:
            browser = "page" in getattr(item, "fixturenames", ())
            if browser or item.get_closest_marker("full"):
                item.add_marker(pytest.mark.skip(reason="slow by design; --full runs it"))
    if not os.environ.get("HAMMERSTEIN_LONG"):
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason=LONG))


@pytest.fixture(autouse=True, scope="session")
def own_cache(tmp_path_factory):
    """Keep results of identifications for this run of the tests only, and no results of runs.

    Processes that share the tests (pytest-xdist) share these, too.
    """
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAMMERSTEIN_CACHE", str(folder / "cache"))
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
