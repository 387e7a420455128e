"""What is published beside the package: conda recipe, release, site, paper, notebooks."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import nbformat
import numpy as np
import pytest
import yaml

pytestmark = pytest.mark.full

TOP = Path(__file__).parents[2]
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]
CONDA_NAMES = {"matplotlib": "matplotlib-base", "lazy-loader": "lazy_loader"}
"""What conda-forge calls differently."""
NOTEBOOKS = sorted((TOP / "hammerstein/examples").glob("*.ipynb"))


def test_the_recipe_for_conda_says_what_pyproject_says() -> None:
    recipe = yaml.safe_load((TOP / ".ci/conda/recipe.yaml").read_text())
    assert recipe["package"] == {"name": PROJECT["name"], "version": PROJECT["version"]}
    needed = [re.fullmatch(r"([\w.-]+)(.*)", entry) for entry in PROJECT["dependencies"]]
    wanted = {f"{CONDA_NAMES.get(found[1], found[1])} {found[2]}" for found in needed if found}
    assert set(recipe["requirements"]["run"]) == wanted | {f"python {PROJECT['requires-python']}"}
    scripts = {f"{name} = {place}" for name, place in PROJECT["scripts"].items()}
    assert set(recipe["build"]["python"]["entry_points"]) == scripts
    assert recipe["about"]["license"] == PROJECT["license"]


def test_a_release_runs_the_steps_that_run_here() -> None:
    steps = yaml.safe_load((TOP / ".github/workflows/release.yml").read_text())["jobs"]["build"]["steps"]
    commands = [step["run"] for step in steps if "run" in step]
    assert '.ci/release dist "$GITHUB_REF_NAME"' in commands
    assert '.ci/release "$temporary/dist"' in (TOP / ".ci/run").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="a shell script")
def test_a_tag_that_is_not_the_version_is_refused(tmp_path: Path) -> None:
    done = subprocess.run(
        [TOP / ".ci/release", tmp_path / "dist", "v99.0"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert f"the tag is v99.0, and pyproject.toml has version {PROJECT['version']}" in done.stderr


def test_the_site_has_every_page_and_no_lost_link(tmp_path: Path) -> None:
    for script in ("site", "links"):
        subprocess.run([sys.executable, TOP / f".ci/{script}.py", tmp_path], check=True, cwd=TOP)
    pages = {page.stem for page in (tmp_path / "hammerstein/guide").glob("*.html")}
    assert pages == {page.stem for page in (TOP / "hammerstein/guide").glob("*.md")}
    gallery = (tmp_path / "gallery.html").read_text()
    assert [f for f in (TOP / "scenarios").glob("*.toml") if f'id="{f.stem}"' not in gallery] == []
    keys = (tmp_path / "keys.html").read_text()
    for key in ("sensitivity", "measured_cycles", "sample_time_s", "smooth_start_s"):
        assert f"<code>{key}</code>" in keys
    assert '<h2 id="Uncertainty">' in keys


def test_numbers_of_the_paper_are_those_of_the_guide() -> None:
    paper, guide = (
        (TOP / name).read_text() for name in (".github/paper.md", "hammerstein/guide/compensators.md")
    )
    lines = re.findall(r"^\|.*\| [\d.]+ to [\d.]+ \|$", paper, flags=re.M)
    assert len(lines) == 5
    assert [found for found in lines if found not in guide] == []  # tests/readme_figures.py writes both
    cited = set(re.findall(r"@(\w+)", paper))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", (TOP / ".github/paper.bib").read_text(), flags=re.M))


def _run(notebook: Path) -> dict[str, object]:
    names: dict[str, object] = {}
    for number, cell in enumerate(json.loads(notebook.read_text())["cells"]):
        if cell["cell_type"] == "code":
            code = compile(
                "".join(cell["source"]), f"{notebook.name}, cell {number}", "exec", dont_inherit=True
            )
            exec(code, names)
    return names


def test_notebooks_are_valid_and_keep_no_output() -> None:
    assert [notebook.stem for notebook in NOTEBOOKS] == ["own_records_to_drive", "what_the_paper_found"]
    for notebook in NOTEBOOKS:
        book = nbformat.read(notebook, as_version=4)
        nbformat.validate(book)
        assert all(not cell.outputs for cell in book.cells if cell.cell_type == "code")


def test_the_notebook_of_own_records_ends_with_a_path_that_is_followed() -> None:
    """Half a percent of 40 um of travel; without compensation hysteresis alone is a tenth of it."""
    assert np.max(_run(NOTEBOOKS[0])["error_um"]) < 0.2


def test_the_notebook_of_the_paper_finds_what_it_says() -> None:
    names = _run(NOTEBOOKS[1])
    errors = names["errors"]
    assert (errors["paper"].diff().dropna() > 0.0).all()  # it grows with the frequency
    assert (errors["with dynamics"] < 0.1 * errors["paper"]).all()
    assert "slope" in str(names["refused"])
