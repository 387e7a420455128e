"""One hostile case after another against the command line, and what must hold of each."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import random
import re
import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from hammerstein.commands.cli import main
from hammerstein.errors import HammersteinError
from hammerstein.experiment.plan import plan_of
from hammerstein.experiment.study import plan_of_study
from hammerstein.scenario import Scenario, load_scenario

CODES = {0, 1, 2, 3, 4}
LONGEST_S, LARGEST = 2.0, 3e8
"""Plans beyond are not run here: that they are announced or refused is tested by itself."""
TOP = Path(__file__).parents[2]
SILENT = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""What Python shows nobody, unless it is our own."""
NOT_FINITE = re.compile(r"(?i)[-+]?(nan|inf(inity)?)")
WORD = re.compile(rb"[-+]?[0-9][0-9.]*(?:[eE][-+]?[0-9]+)?|[A-Za-z_]{2,}")
EDGES = (b"nan", b"inf", b"-1", b"0", b"1e308", b"-1e308", b"5e-324", b"1e400", b"9" * 30, b"", b'""', b"[]",
         b"{}", b"x", b"true", b"1.5", b"1e3", b"\xff", "\u202e".encode(), b"\r\n")  # fmt: skip
OPERATORS_OF_ONE = {
    "question": "?",
    "actuator": "duo_bimorph_static",
    "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 50.0},
}
SMALL = {
    "question": "?",
    "reference": {"kind": "sine", "amplitude_um": 10.0, "frequency_hz": 50.0},
    "compensators": [{"label": "a", "law": "none", "model": "duo_bimorph"}],
}


class FindingError(AssertionError):
    """Something that must not happen to a person."""


def call(*arguments: Any) -> tuple[int, str, str]:
    """Exit code of a command, what it said and what it printed.

    FindingError where it ended otherwise than with a message, or where a person would read a warning.
    """
    said, printed = io.StringIO(), io.StringIO()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stderr(said):
        warnings.simplefilter("always")
        with contextlib.redirect_stdout(printed):
            try:
                main([str(argument) for argument in arguments])
            except SystemExit as end:
                code = end.code or 0
            else:
                code = 0
    text = said.getvalue()
    if code not in CODES or "Traceback" in text or "internal error" in text:
        raise FindingError(f"{arguments}: exit code {code}\n{text}")
    if code and not (text + printed.getvalue()).strip():
        raise FindingError(f"{arguments}: exit code {code} without a word")
    for w in caught:
        if "hammerstein" in str(w.filename) or not issubclass(w.category, SILENT):
            raise FindingError(f"{arguments}: warns {w.message} in {w.filename}:{w.lineno}")
    return int(code), text, printed.getvalue()


def named(arguments: Any, outcome: tuple[int, str, str], *names: str) -> int:
    """Exit code; FindingError where a refusal names none of these files or options."""
    code, said, printed = outcome
    if code and not any(name in said + printed for name in names):
        raise FindingError(f"{arguments}: exit code {code} names none of {names}: {said}{printed[:500]}")
    return code


def warm_up() -> None:
    """Load what every command needs."""
    import hammerstein.experiment.simulated_identification
    import hammerstein.reporting.figures.write  # noqa: F401


def scenario_case(content: Any, folder: Path) -> int:
    """Run a scenario; every number that is written must be finite, every refusal must name the file."""
    return file_case(toml(content).encode(), folder)


def file_case(data: bytes, folder: Path, *others: str) -> int:
    """Run the bytes of a scenario file, which may name other files."""
    path = folder / "case.toml"
    path.write_bytes(data)
    try:
        scenario = load_scenario(path)
        studied = _is_studied(scenario)
        plan = plan_of_study(scenario, "case") if studied else plan_of(scenario)
    except HammersteinError:
        plan, studied = None, False
    if plan is not None and (plan.seconds > LONGEST_S or plan.bytes > LARGEST):
        return -1
    if studied:
        return study_case(path, folder)
    code = named(
        "run", call("run", path, "--no-figures", "--out", folder / "out", "--jobs", 1), "case", *others
    )
    if code == 0:
        for written in ("report.json", "rms.csv"):
            refuse_not_finite(folder / "out/case" / written)
    return code


def is_long(path: Path) -> bool:
    """Whether a scenario file asks for more than is run here; what cannot be read is short."""
    try:
        scenario = load_scenario(path)
        plan = plan_of_study(scenario, "case") if scenario.study is not None else plan_of(scenario)
    except (HammersteinError, ArithmeticError):
        return False
    return plan.seconds > LONGEST_S or plan.bytes > LARGEST


def _is_studied(scenario: Scenario) -> bool:
    """Whether it has a study of a few runs."""
    return scenario.study is not None and scenario.study.count() < 10


def study_case(path: Path, folder: Path) -> int:
    """Run a scenario with the values of its study; what is not finite stands in no cell."""
    rows = folder / "rows.csv"
    rows.unlink(missing_ok=True)
    code = named("sweep", call("sweep", path, "--out", rows, "--fresh"), "case")
    if code == 0:
        refuse_not_finite(rows)
    return code


def shown_case(data: bytes, name: str, folder: Path) -> int:
    """Show what the bytes of a file hold."""
    path = folder / name
    path.write_bytes(data)
    outcome = call("show", path, "--json")
    if not outcome[0]:
        _refuse_json(outcome[2])
    return named("show", outcome, name)


def results(folder: Path) -> list[tuple[str, bytes]]:
    """Files that the program writes and shows: a report, a comparison, a fit report, a drive file."""
    (folder / "small.toml").write_text(toml(SMALL))
    (folder / "path.csv").write_bytes(path_bytes())
    call("run", folder / "small.toml", "--no-figures", "--out", folder / "shown", "--jobs", 1)
    call("compensate", "duo_bimorph", folder / "path.csv", "--out", folder / "drive.csv")
    record = next(data for name, data, _ in records(folder) if name == "seed.csv")
    (folder / "loop.csv").write_bytes(record)
    words = ["--inputs", "u", "--outputs", "y", "--rate", 1000, "--no-figures", "--dynamics", "none"]
    call("identify", folder / "loop.csv", *words, "--out", folder / "own.json", "--operators", 5)
    call("compare", folder / "loop.csv", *words, "--out", folder / "compared", "--jobs", 1, "--operators", 5)
    made = ["shown/small/report.json", "drive.csv", "own_fit/fit.json", "compared/compare.json", "own.json"]
    return [(Path(name).name, (folder / name).read_bytes()) for name in made]


def model_case(content: Any, folder: Path) -> int:
    """Load a model and drive it."""
    return model_file_case(json.dumps(content).encode(), folder)


def model_file_case(data: bytes, folder: Path) -> int:
    """Drive what the bytes of a model file say."""
    (folder / "model.json").write_bytes(data)
    scenario = {
        "question": "?",
        "actuator": "model.json",
        "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 50.0},
        "instruments": {"drive": {"sample_time_s": 5e-5}},
    }
    return file_case(toml(scenario).encode(), folder, "model.json")


def record_case(data: bytes, name: str, columns: tuple[str, str], folder: Path, fitted: bool = False) -> int:
    """Find the loops in the bytes of a record, or identify a model from them."""
    path = folder / name
    path.write_bytes(data)
    options = ["--inputs", columns[0], "--outputs", columns[1], "--rate", 1000, "--no-figures", "--json"]
    command = (
        ["identify", path, *options, "--out", folder / "fitted.json"] if fitted else ["loops", path, *options]
    )
    (folder / "fitted.json").unlink(missing_ok=True)
    outcome = call(*command)
    if not outcome[0]:
        _refuse_json(outcome[2])
        if fitted:
            refuse_not_finite(folder / "fitted.json")
    return named(command, outcome, name, f"{path.stem}", "--")


def path_case(data: bytes, folder: Path) -> int:
    """Turn the bytes of a path into voltages."""
    path, out = folder / "path.csv", folder / "drive.csv"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    outcome = call("compensate", "duo_bimorph", path, "--out", out, "--json")
    if not outcome[0]:
        _refuse_json(outcome[2])
        refuse_not_finite(out)
    return named("compensate", outcome, "path.csv", "--")


def baseline_case(data: bytes, folder: Path) -> int:
    """Check a scenario against the bytes of a baseline."""
    (folder / "base").mkdir(exist_ok=True)
    (folder / "base" / "operators_of_one.json").write_bytes(data)
    path = folder / "operators_of_one.toml"
    path.write_text(toml(OPERATORS_OF_ONE))
    outcome = call("check", path, "--baseline", folder / "base", "--jobs", 1)
    return named("check", outcome, "operators_of_one")


def good_baseline(folder: Path) -> bytes:
    """Baseline of the scenario that ``baseline_case`` checks."""
    path = folder / "operators_of_one.toml"
    path.write_text(toml(OPERATORS_OF_ONE))
    call("check", path, "--baseline", folder / "base", "--jobs", 1, "--update-baseline")
    return (folder / "base" / "operators_of_one.json").read_bytes()


def mutated(data: bytes, draw: random.Random) -> bytes:
    """Bytes of a file after a few accidents: flipped, lost, doubled, cut short."""
    out = bytearray(data)
    if 0 not in data and draw.random() < 0.4:
        return _with_another_word(data, draw)
    for _ in range(draw.choice([1, 1, 2, 5])):
        if not out:
            break
        place = draw.randrange(len(out))
        accident = draw.randrange(5)
        if accident < 2:
            out[place] = draw.randrange(256)
        elif accident == 2:
            del out[place : place + draw.randrange(1, 20)]
        elif accident == 3:
            out[place:place] = out[place : place + draw.randrange(1, 20)]
        else:
            del out[place:]
    return bytes(out)


def _with_another_word(data: bytes, draw: random.Random) -> bytes:
    """A text in which one number or word is another one, so that its form stays right."""
    word = draw.choice(list(WORD.finditer(data)) or [None])
    if word is None:
        return data
    others = [w for w in (*EDGES, WORD.findall(data)[0], draw.choice(WORD.findall(data))) if w != word[0]]
    return data[: word.start()] + draw.choice(others) + data[word.end() :]


def shipped() -> Iterator[tuple[str, bytes]]:
    """Files that come with the project."""
    for pattern in ("scenarios/*.toml", "hammerstein/actuators/*.json", "reports/baseline/*.json"):
        for path in sorted(TOP.glob(pattern)):
            yield path.name, path.read_bytes()


def records(folder: Path) -> list[tuple[str, bytes, tuple[str, str]]]:
    """A small record in every format."""
    import h5py
    from scipy.io import savemat

    time = np.arange(300) * 1e-3
    u = 5.0 * np.sin(2.0 * np.pi * 10.0 * time)
    y = 3.0 * np.sin(2.0 * np.pi * 10.0 * time - 0.2)
    rows = list(zip(time, u, y, strict=True))
    lines = ["t,u,y", *(f"{a:.6g},{b:.6g},{c:.6g}" for a, b, c in rows)]
    (folder / "seed.csv").write_text("\n".join(lines) + "\n")
    lines = ["measured on Monday", "t [ms];u [mV];y [nm]"]
    lines += [f"{1e3 * a:.4f};{1e3 * b:.3f};{1e3 * c:.3f}".replace(".", ",") for a, b, c in rows]
    (folder / "seed_units.txt").write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode())
    np.save(folder / "seed.npy", np.column_stack([u, y]))
    np.savez_compressed(folder / "seed.npz", u=u, y=y)
    savemat(folder / "seed.mat", {"u": u, "y": y})
    savemat(folder / "seed_packed.mat", {"u": u, "Y": {"y": y}}, do_compression=True)
    with h5py.File(folder / "seed_hdf.mat", "w") as file:
        file["u"], file["y"] = u[None, :], y[None, :]
    names = ["seed.csv", "seed_units.txt", "seed.npz", "seed.mat", "seed_hdf.mat"]
    if find_spec("pyarrow"):
        pd.DataFrame({"u": u, "y": y}).to_parquet(folder / "seed.parquet")
        names.append("seed.parquet")
    found = [(name, ("u", "y")) for name in names]
    found += [("seed.npy", ("1", "2")), ("seed_packed.mat", ("u", "Y.y"))]
    return [(name, (folder / name).read_bytes(), columns) for name, columns in found]


def option_case(line: list[str], folder: Path) -> int:
    """Do what a command line says, in a folder with the files that it may name."""
    from . import options

    place = options.furnish(folder)
    mine = {path: path.read_bytes() for path in (place / "folder").iterdir()}
    with contextlib.chdir(place):
        outcome = call(*line)
    if any(not path.exists() or path.read_bytes() != data for path, data in mine.items()):
        raise FindingError(f"{line}: a file of a person is lost")
    if not outcome[0]:
        if "--json" in line and outcome[2].startswith("{"):
            _refuse_json(outcome[2])
        for path in place.rglob("*"):
            if path.suffix in (".json", ".csv") and path.is_file() and path.name not in options.FILES:
                refuse_not_finite(path)
    return named(line, outcome, *options.names_of(line))


def path_bytes() -> bytes:
    """A path of two axes as ``compensate`` reads it."""
    time = np.arange(200) * 5e-5
    rows = zip(time, 5.0 - 5.0 * np.cos(300.0 * time), np.zeros(200), strict=True)
    return "\n".join(["time_s,x,y", *(",".join(f"{v:.9g}" for v in row) for row in rows)]).encode() + b"\n"


def toml(content: Any) -> str:
    """Text of a TOML file, with whatever stands in it; not even valid where the content is no table."""
    if not isinstance(content, dict):
        return repr(content)
    return "\n".join(f"{_key(name)} = {_inline(value)}" for name, value in content.items()) + "\n"


def _key(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value, ensure_ascii=True)


def refuse_not_finite(path: Path) -> None:
    """Look at every number of a file that was written."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        _refuse_json(text)
        return
    for line in csv.reader(text.splitlines()):
        if any(NOT_FINITE.fullmatch(cell.strip()) for cell in line):
            raise FindingError(f"{path.name} contains a number that is not finite: {line}")


def _refuse_json(text: str) -> None:
    def refused(word: str) -> None:
        raise FindingError(f"a result holds {word}")

    _refuse_infinite(json.loads(text, parse_constant=refused))


def _refuse_infinite(value: Any) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise FindingError("a number in a result is not finite")
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _refuse_infinite(part)


def watched(work: Callable[[], int]) -> tuple[int | None, str]:
    """Exit code of a case, or what was found."""
    try:
        return work(), ""
    except Exception as error:
        return None, f"{type(error).__name__}: {error}"
