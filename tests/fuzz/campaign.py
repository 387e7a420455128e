"""One hostile case after another against the command line, and what must hold of each."""

from __future__ import annotations

import contextlib
import io
import json
import math
import random
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.commands.cli import main
from hammerstein.errors import HammersteinError
from hammerstein.experiment.plan import plan_of
from hammerstein.scenario import load_scenario

CODES = {0, 1, 2, 3, 4}
LONGEST_S, LARGEST = 2.0, 3e8
"""Plans beyond are not run here: that they are announced or refused is tested by itself."""
TOP = Path(__file__).parents[2]


class FindingError(AssertionError):
    """Something that must not happen to a person."""


def call(*arguments: Any) -> tuple[int, str]:
    """Exit code of a command and what it said; FindingError where it ended otherwise than with a message."""
    said = io.StringIO()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stderr(said):
        warnings.simplefilter("always")
        with contextlib.redirect_stdout(io.StringIO()):
            try:
                main([str(argument) for argument in arguments])
            except SystemExit as end:
                code = end.code or 0
            else:
                code = 0
    text = said.getvalue()
    if code not in CODES or "Traceback" in text or "internal error" in text:
        raise FindingError(f"{arguments}: exit code {code}\n{text}")
    if code and not text.strip() and arguments[0] != "check":
        raise FindingError(f"{arguments}: exit code {code} without a word")
    ours = [w for w in caught if "hammerstein" in str(w.filename)]
    if ours:
        raise FindingError(f"{arguments}: warns {ours[0].message} in {ours[0].filename}:{ours[0].lineno}")
    return int(code), text


def scenario_case(content: Any, folder: Path) -> int:
    """Run a scenario; every number that is written must be finite, every refusal must name the file."""
    return file_case(toml(content).encode(), folder)


def file_case(data: bytes, folder: Path) -> int:
    """Run the bytes of a scenario file."""
    path = folder / "case.toml"
    path.write_bytes(data)
    try:
        plan = plan_of(load_scenario(path))
    except HammersteinError:
        plan = None
    if plan is not None and (plan.seconds > LONGEST_S or plan.bytes > LARGEST):
        return -1
    code, text = call("run", path, "--no-figures", "--out", folder / "out", "--jobs", 1)
    if code == 2 and "case" not in text:
        raise FindingError(f"does not name the file: {text}")
    if code == 0:
        _refuse_not_finite(json.loads((folder / "out/case/report.json").read_text()))
    return code


def model_case(content: Any, folder: Path) -> int:
    """Load a model and drive it."""
    (folder / "model.json").write_text(json.dumps(content), encoding="utf-8")
    scenario = {
        "question": "?",
        "actuator": "model.json",
        "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 50.0},
        "instruments": {"drive": {"sample_time_s": 5e-5}},
    }
    return scenario_case(scenario, folder)


def record_case(data: bytes, name: str, columns: tuple[str, str], folder: Path) -> int:
    """Find the loops in the bytes of a record."""
    path = folder / name
    path.write_bytes(data)
    options = ("--inputs", columns[0], "--outputs", columns[1], "--rate", 1000, "--no-figures")
    code, text = call("loops", path, *options)
    if code and name not in text:
        raise FindingError(f"does not name the file: {text}")
    return code


def baseline_case(data: bytes, folder: Path) -> int:
    """Check a scenario against the bytes of a baseline."""
    (folder / "base").mkdir(exist_ok=True)
    (folder / "base" / "operators_of_one.json").write_bytes(data)
    scenario = {
        "question": "?",
        "actuator": "duo_bimorph_static",
        "drive": {"kind": "sine", "amplitude_v": 5.0, "frequency_hz": 50.0},
    }
    path = folder / "operators_of_one.toml"
    path.write_text(toml(scenario))
    return call("check", path, "--baseline", folder / "base", "--jobs", 1)[0]


def mutated(data: bytes, draw: random.Random) -> bytes:
    """Bytes of a file after a few accidents: flipped, lost, doubled, cut short."""
    out = bytearray(data)
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


def shipped() -> Iterator[tuple[str, bytes]]:
    """Files that come with the project."""
    for pattern in ("scenarios/*.toml", "hammerstein/actuators/*.json", "reports/baseline/*.json"):
        for path in sorted(TOP.glob(pattern)):
            yield path.name, path.read_bytes()


def records(folder: Path) -> list[tuple[str, bytes, tuple[str, str]]]:
    """A small record in every format."""
    from scipy.io import savemat

    time = np.arange(300) * 1e-3
    u = 5.0 * np.sin(2.0 * np.pi * 10.0 * time)
    y = 3.0 * np.sin(2.0 * np.pi * 10.0 * time - 0.2)
    lines = ["t,u,y", *(f"{a:.6g},{b:.6g},{c:.6g}" for a, b, c in zip(time, u, y, strict=True))]
    (folder / "seed.csv").write_text("\n".join(lines) + "\n")
    np.save(folder / "seed.npy", np.column_stack([u, y]))
    np.savez_compressed(folder / "seed.npz", u=u, y=y)
    savemat(folder / "seed.mat", {"u": u, "y": y})
    found = [(name, ("u", "y")) for name in ("seed.csv", "seed.npz", "seed.mat")] + [("seed.npy", ("1", "2"))]
    return [(name, (folder / name).read_bytes(), columns) for name, columns in found]


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


def _refuse_not_finite(value: Any) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise FindingError("a number in a report is not finite")
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _refuse_not_finite(part)
