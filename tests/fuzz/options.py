"""Command lines: every command of the program with any of its options, and shipped files as arguments."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from typer.main import get_command

from hammerstein.commands.cli import app
from hammerstein.escaping import clean

from . import campaign

FILES = ("small.toml", "drive.toml", "round ü.toml", "loop.csv", "two.csv", "units.txt", "loop.npy",
         "loop.mat", "path.csv", "model.json", "base.json", "empty.csv", "noise.bin", "scenarios", "folder",
         "missing.toml", "a\x1bb", "link.toml", "nowhere/x.toml", "n" * 300, "", "study.toml",
         "report.json", "volts.csv", "code")  # fmt: skip
USUAL_FILES = {
    "run": ("small.toml", "drive.toml", "round ü.toml", "scenarios"),
    "check": ("small.toml", "drive.toml", "scenarios"),
    "plot": ("small.toml", "drive.toml"),
    "loops": ("loop.csv", "two.csv", "units.txt", "loop.npy", "loop.mat"),
    "identify": ("loop.csv", "two.csv", "loop.mat"),
    "model": ("duo_bimorph", "model.json", "duo_bimorph_creep"),
    "reference": ("path.csv",),
    "compare": ("loop.csv", "two.csv"),
    "sweep": ("study.toml", "study.toml", "small.toml"),
    "drive": ("volts.csv", "two.csv", "path.csv"),
    "folder": ("new", "folder", "link", "scenarios"),
    "show": FILES,
    "topic": ("start", "kinds", "nothing"),
}
SELDOM = {"init": 0.9, "compare": 0.7, "identify": 0.3}
"""Part of the command lines that take another command instead: these take seconds."""
NUMBERS = ("1", "0", "-1", "5", "10", "20000", "1000", "0.5", "1e-9", "1e9", "1e308", "nan", "inf", "-inf",
           "", "x", "1,5", "0x10", "99999999999999999999", "٣")  # fmt: skip
WORDS = ("u", "y", "u,y", "u_x,u_y", "x,y", "t", "1", "2", "1,2", "0", "auto", "none", "time", "voltage",
         "fitted", "invertible", "least_squares", "nonnegative", "closed_form", "second_order", "state_space",
         "hammerstein_inverse", "exact_inverse", "decoupled_inverse", "feedback", "identity", "csv", "mat",
         "-10,10", "0,10", "10,0", "5", "0,1,2", "0,nan", "3,1", ",", "", "out", "r/é", "../up", "\x1b[31m",
         "=1+1", "loop.csv", "--json", "w" * 5000)  # fmt: skip
NEEDED = {"--inputs": ("u", "u", "1"), "--outputs": ("y", "y", "2"), "--rate": ("1000",), "--out": ("out",),
          "--jobs": ("1",)}  # fmt: skip
OUT_FILES = {
    "identify": ("model2.json",),
    "compensate": ("drive.csv",),
    "play": ("played.csv",),
    "sweep": ("rows.csv", "rows.parquet"),
}
OUT_OF_FILES = {
    "--out": ("out", "r", "small.toml", "folder", "model.json", "nowhere/deep", "link", "drive.csv")
}


STUDY = """
[study]
values = { "reference.amplitude_um" = [5, 10] }
"""


def commands() -> dict[str, Any]:
    """Every command with its parameters, as Typer has made them."""
    group: Any = get_command(app)
    return dict(group.commands)


def command_lines() -> st.SearchStrategy[list[str]]:
    """Arguments of the program."""
    known = commands()

    @st.composite
    def draw(drawn: Any) -> list[str]:
        chance = drawn(st.randoms(use_true_random=False))
        if chance.random() < 0.02:
            return [chance.choice((*WORDS, "--version", "-h", "--", "-"))]
        name = chance.choice(list(known))
        if chance.random() < SELDOM.get(name, 0.0):
            name = chance.choice([other for other in known if other not in SELDOM])
        line = [name]
        for parameter in known[name].params:
            form = _option if hasattr(parameter, "is_flag") else _argument
            line += form(parameter, name, chance)
        if chance.random() < 0.05:
            line.insert(chance.randrange(len(line) + 1), chance.choice((*WORDS, "--outt", "--", "-x")))
        if chance.random() < 0.05 and len(line) > 1:
            del line[chance.randrange(1, len(line))]
        # No more than one process: what the campaign tries is the words, and processes cost seconds.
        several = any("--jobs" in p.opts for p in known[name].params) and "--jobs" not in line
        return [*line, "--jobs", "1"] if several else line

    return draw()


def _argument(parameter: Any, command: str, chance: Any) -> list[str]:
    usual = USUAL_FILES.get(parameter.name or "", USUAL_FILES.get(command, FILES))
    count = chance.choice([1, 1, 1, 2]) if parameter.nargs != 1 else 1
    return [chance.choice(usual if chance.random() < 0.85 else FILES) for _ in range(count)]


def _option(parameter: Any, command: str, chance: Any) -> list[str]:
    name = chance.choice([*parameter.opts, *parameter.secondary_opts])
    needed = name in NEEDED and chance.random() < 0.9
    if name == "--help" or not (needed or chance.random() < 0.2):
        return (
            ["--no-figures"] if "--no-figures" in parameter.secondary_opts and chance.random() < 0.9 else []
        )
    if parameter.is_flag:
        return [name]
    if parameter.nargs == 2:  # a trial
        return [name, *(chance.choice(("volts.csv", "volts.csv", *FILES)) for _ in range(2))]
    if needed and chance.random() < 0.85:
        if name == "--out" and command in OUT_FILES:
            return [name, chance.choice(OUT_FILES[command])]
        return [name, chance.choice(NEEDED[name])]
    if name == "--jobs":
        return [name, chance.choice(("0", "-1", "x", "1"))]
    if name in OUT_OF_FILES:
        return [name, chance.choice(OUT_OF_FILES[name])]
    described = getattr(parameter, "type_descriptor", None)
    kind = str(described.annotation) if described else repr(parameter.type)  # older Typer: click's types
    if "Path" in kind:
        return [name, chance.choice(FILES)]
    numeric = any(word in kind.lower() for word in ("float", "int"))
    return [name, chance.choice(NUMBERS if numeric and chance.random() < 0.9 else (*WORDS, *NUMBERS))]


def furnish(folder: Path) -> Path:
    """Make the files that command lines name; gives the folder to work in, anew each time."""
    place = folder / "down" / "work"
    shutil.rmtree(folder / "down", ignore_errors=True)
    (place / "scenarios").mkdir(parents=True)
    (place / "folder").mkdir()
    drive, small = campaign.toml(campaign.OPERATORS_OF_ONE), campaign.toml(campaign.SMALL)
    for name, text in (("small", small), ("drive", drive), ("round ü", drive), ("scenarios/one", drive)):
        (place / f"{name}.toml").write_text(text, encoding="utf-8")
    seeds = {name: data for name, data, _ in _records(folder)}
    for name, seed in (("loop.csv", "seed.csv"), ("units.txt", "seed_units.txt"), ("loop.npy", "seed.npy"),
                       ("loop.mat", "seed.mat")):  # fmt: skip
        (place / name).write_bytes(seeds[seed])
    lines = seeds["seed.csv"].decode().splitlines()
    wide = ["t,u_x,u_y,x,y", *(f"{row},0,0".replace(",0,0", ",0.1,0.2") for row in lines[1:])]
    (place / "two.csv").write_text("\n".join(wide) + "\n")
    (place / "path.csv").write_bytes(campaign.path_bytes())
    shipped = dict(campaign.shipped())
    (place / "study.toml").write_text(small + STUDY)
    lines = campaign.path_bytes().decode().splitlines()
    (place / "volts.csv").write_text("\n".join(["time_s,u_x,u_y", *lines[1:]]) + "\n")
    (place / "report.json").write_text(json.dumps({"format": "hammerstein-report/1", "rows": 3}))
    (place / "model.json").write_bytes(shipped["duo_bimorph_static.json"])
    (place / "base.json").write_bytes(shipped["static_inverse.json"])
    (place / "empty.csv").write_bytes(b"")
    (place / "noise.bin").write_bytes(bytes(range(256)) * 20)
    (place / "folder" / "beach.png").write_bytes(b"mine")
    for link, target in (("link.toml", "small.toml"), ("link", "folder")):
        (place / link).symlink_to(target)
    return place


_SEEDS: list[tuple[str, bytes, tuple[str, str]]] = []


def _records(folder: Path) -> list[tuple[str, bytes, tuple[str, str]]]:
    if not _SEEDS:
        _SEEDS.extend(campaign.records(folder))
    return _SEEDS


def names_of(line: list[str]) -> list[str]:
    """What a refusal may name: an option, a file of the line, or what Typer says of the line itself."""
    options = {
        name for command in commands().values() for p in command.params for name in p.opts if "-" in name
    }
    given = [word for word in line[1:] if word and not word.startswith("-")]
    files = [
        name
        for word in given
        for name in ((clean(word), f'"{Path(word).stem}"') if word in FILES else (f"{word}: ", repr(word)))
    ]
    of_typer = ["Missing argument", "Missing command", "No such", "Got unexpected"]
    return [*options, *files, *of_typer, "'' ", ".: "]
