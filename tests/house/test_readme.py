"""Every command of the README does what it says."""

import re
import shlex
import shutil
from pathlib import Path

import pytest

from hammerstein.commands.cli import main

TOP = Path(__file__).parents[2]
README = (TOP / "README.md").read_text(encoding="utf-8")


def _commands():
    """Commands in blocks and in the text, each once; those of pip and pytest are not ours."""
    fenced = re.findall(r"^```\n(.*?)^```$", README, flags=re.M | re.S)
    blocks = [line.rpartition("&& ")[2] for block in fenced for line in block.splitlines()]
    inline = re.findall(r"`(hammerstein [^`\n]+)`", README)
    return [c for c in dict.fromkeys((*blocks, *inline)) if c.startswith(("hammerstein ", "cd "))]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a reader of the README has beside it: two scenarios."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "scenarios").mkdir()
    for name in ("circles", "static_inverse"):
        shutil.copy(TOP / "scenarios" / f"{name}.toml", folder / "scenarios")
    return folder


@pytest.fixture(scope="module")
def own_folder(folder):
    """The folder that its commands have made and gone into."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in _commands():
            if command.startswith("cd "):
                patch.chdir(command.removeprefix("cd "))
                continue
            quick = ["--no-figures"] if " run " in command else []
            assert _call(*shlex.split(command)[1:], *quick) == 0, command
        return Path.cwd()


def test_the_readme_has_commands():
    assert len(_commands()) >= 6


@pytest.mark.full
def test_every_command_of_the_readme_runs(own_folder):
    assert own_folder.name == "my_stage"
    for file in ("own.json", "own_fit/report.html", "drive.csv", "played.csv", "controller/selftest.c"):
        assert (own_folder / file).exists(), file


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    return caught.value.code or 0


@pytest.mark.full
def test_the_model_of_the_readme_runs_in_scenarios(own_folder, monkeypatch, capsys):
    """Its inputs are u_x, u_y and its outputs x, y: axes of different names crashed the table of results."""
    monkeypatch.chdir(own_folder)
    tables = {
        "loop": '[drive]\nkind = "sine"\namplitude_v = 8\nfrequency_hz = 50\n',
        "path": (
            '[reference]\nkind = "circle"\nradius_um = 15\nfrequency_hz = 50\nsmooth_start_s = 0.02\n'
            '[[compensators]]\nlabel = "own"\nlaw = "exact_inverse"\nmodel = "own.json"\n'
        ),
    }
    for name, table in tables.items():
        Path(f"{name}.toml").write_text(f'question = "?"\nactuator = "own.json"\n{table}')
        assert _call("run", f"{name}.toml") == 0
        assert name in capsys.readouterr().out
