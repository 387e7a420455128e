"""Every command and every line of Python in the README does what it says."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main
from hammerstein.model import HammersteinModel
from hammerstein.model.simulation import Plant
from hammerstein.signals import Multisine, Sine

TOP = Path(__file__).parents[2]
README = (TOP / "README.md").read_text(encoding="utf-8")
T = 50e-6


def _blocks(language):
    """Contents of the fenced blocks of a language; one fence after another, for their ends look alike."""
    found = re.findall(r"^```(\w*)\n(.*?)^```$", README, flags=re.M | re.S)
    return [content for name, content in found if name == language]


def _commands():
    """Commands in blocks and in the text, each once; those of pip and pytest are not ours."""
    blocks = [line.rpartition("&& ")[2] for block in _blocks("") for line in block.splitlines()]
    inline = re.findall(r"`(hammerstein [^`\n]+)`", README)
    commands = [command.partition(" > ")[0] for command in (*blocks, *inline)]
    named_only = {
        "hammerstein check",
        "hammerstein run",
        "hammerstein identify",
        "hammerstein sweep",
    }  # spoken of, not to be typed
    return [c for c in dict.fromkeys(commands) if c.startswith("hammerstein ") and c not in named_only]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What a reader of the README has beside it: records of two axes, a path, two scenarios."""
    folder = tmp_path_factory.mktemp("readme")
    actuator = HammersteinModel.load("duo_bimorph")
    time_s = np.arange(3000) * T
    bursts = [
        Sine(amplitude=10.0, frequency_hz=50.0, axis=1).sample(time_s, 1)[0],
        Multisine(amplitude=10.0, lowest_hz=5.0, highest_hz=450.0).sample(time_s, 1)[0],
    ]
    wave = np.concatenate(bursts)
    for k, axis in enumerate("xy"):
        u = np.zeros((2, wave.size))
        u[k] = wave
        response = Plant(actuator, actuator.instruments).respond(u, [k])
        columns = {"t": np.arange(wave.size) * T, "u_x": u[0], "u_y": u[1]}
        columns |= {"x": response.reading_um[0], "y": response.reading_um[1]}
        for name in (f"record_{axis}.csv", f"{axis}.csv", *(["record.csv"] if k == 0 else [])):
            pd.DataFrame(columns).to_csv(folder / name, index=False)
    turn = 2.0 * np.pi * 50.0 * time_s
    grow = np.minimum(1.0, time_s / 0.02) ** 2
    path = {"time_s": time_s, "x": 20.0 * grow * np.sin(turn), "y": 20.0 * grow * (1.0 - np.cos(turn))}
    pd.DataFrame(path).to_csv(folder / "path.csv", index=False)
    (folder / "scenarios").mkdir()
    for name in ("circles", "static_inverse"):
        shutil.copy(TOP / "scenarios" / f"{name}.toml", folder / "scenarios")
    (folder / "round.toml").write_text(_blocks("toml")[0])
    return folder


def test_the_readme_has_commands():
    assert len(_commands()) >= 6
    assert len(_blocks("python")) >= 2


def test_every_command_of_the_readme_runs(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert _call("check", "scenarios", "--update-baseline") == 0
    for command in _commands():
        code = _call(*shlex.split(command)[1:], *(["--no-figures"] if " run " in command else []))
        assert code == 0, (command, capsys.readouterr().err)


def _call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main(list(arguments))
    return caught.value.code or 0


def test_the_python_of_the_readme_runs(folder, monkeypatch):
    """One block after another, as a reader types them."""
    monkeypatch.chdir(folder)
    names = {}
    for number, block in enumerate(_blocks("python"), start=1):
        exec(compile(block, f"README.md, block {number}", "exec"), names)


def test_the_model_of_the_readme_runs_in_scenarios(folder, monkeypatch, capsys):
    """Its inputs are u_x, u_y and its outputs x, y: axes of different names crashed the table of results."""
    monkeypatch.chdir(folder)
    if not Path("stage.json").exists():
        assert _call(*shlex.split(next(c for c in _commands() if " identify " in c))[1:], "--no-figures") == 0
    tables = {
        "loop": '[drive]\nkind = "sine"\namplitude_v = 8\nfrequency_hz = 50\n',
        "path": (
            '[reference]\nkind = "circle"\nradius_um = 15\nfrequency_hz = 50\nsmooth_start_s = 0.02\n'
            '[[compensators]]\nlabel = "own"\nlaw = "exact_inverse"\nmodel = "stage.json"\n'
        ),
    }
    for name, table in tables.items():
        Path(f"{name}.toml").write_text(f'question = "?"\nactuator = "stage.json"\n{table}')
        assert _call("run", f"{name}.toml") == 0
        assert name in capsys.readouterr().out
