"""One model of the fine steering mirror for every amplitude: identify it, or write the benchmark's table.

    python reports/measured/one_model/make.py fit FOLDER [MINUTES]
    python reports/measured/one_model/make.py table FOLDER

FOLDER holds the records of github.com/merijnfloren/fsm-benchmark-data (CC BY 4.0). ``fit`` does what
``hammerstein identify --hysteresis-in-loop`` does with the training records, and writes model.json and
trials.json, the structures that were tried. ``table`` prints the table, and writes README.md and table.json.
It alone reads the test records, once there is nothing left to choose.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hammerstein.arrays import Array
from hammerstein.dynamics import on_grid
from hammerstein.identification.in_loop.identify import LoopSettings, identify_in_loop
from hammerstein.model import HammersteinModel
from hammerstein.records.record import Record

HERE = Path(__file__).parent
LEVELS_MV = (100, 200, 300)
TIME_S = 1.0 / 6400.0
PUBLISHED = {
    "linear, a model for each level": (0.114, 0.216, 0.228),
    "one linear model for all": (0.252, 0.179, 0.658),
    "one nonlinear model for all (state space, static nonlinearity in feedback)": (0.087, 0.131, 0.169),
}
LEFT_OUT = 100
"""Samples of a record that do not count in the benchmark's metric."""
BANDS_HZ = (0, 50, 500, 800, 1000, 1200, 1600, 2200, 2600, 3000, 3201)


def records(folder: Path, level_mv: int, part: str) -> tuple[Array, Array]:
    """Voltages [V] and positions [um] (experiment, period, channel, sample) of a level."""
    u, y = (np.load(folder / f"{axis}_{level_mv}mV_{part}.npy") for axis in "uy")
    return tuple(np.ascontiguousarray(np.transpose(a, (2, 3, 1, 0))) for a in (u, 1e6 * y))  # type: ignore[return-value]


def benchmark_rms(simulated: Array, measured: Array) -> float:
    """Root mean square of all errors of one level, all records, channels and samples together.

    The first LEFT_OUT samples of every record do not count.

    Parameters
    ----------
    simulated, measured : (record, channel, sample) positions of one unit

    Source: M. Floren, github.com/merijnfloren/fsm-benchmark-data (2026).
    """
    errors = (measured - simulated)[..., LEFT_OUT:]
    return float(np.sqrt(np.mean(errors * errors)))


def simulated(model: HammersteinModel, u: Array) -> Array:
    """Positions for both periods of every experiment; one period before them ends the transient."""
    m = u.shape[2]
    runs = [np.hstack([periods[0], *periods]) for periods in u]
    found = [model.simulate(run, TIME_S).position_um[:, u.shape[3] :] for run in runs]
    return np.stack([f.reshape(m, u.shape[1], -1).swapaxes(0, 1) for f in found])


def noise(y: Array) -> float:
    """Noise of one period [um], from the difference of the two."""
    return float(np.sqrt(np.mean((y[:, 0] - y[:, 1]) ** 2) / 2.0))


def bands(error: Array) -> list[float]:
    """Rms of errors (..., sample) in each band [um]."""
    lines = np.fft.rfft(error) / error.shape[-1]
    hertz = np.fft.rfftfreq(error.shape[-1], TIME_S)
    power = 2.0 * (np.abs(lines) ** 2).reshape(-1, len(hertz)).mean(axis=0)
    edges = itertools.pairwise(BANDS_HZ)
    return [float(np.sqrt(power[(hertz >= low) & (hertz < high)].sum())) for low, high in edges]


def judged(model: HammersteinModel, folder: Path, part: str) -> dict[str, list[object]]:
    """Errors of all levels on one part of the records."""
    found: dict[str, list[object]] = {"rms_um": [], "noise_um": [], "position_rms_um": [], "bands_um": []}
    for level in LEVELS_MV:
        u, y = records(folder, level, part)
        error = y - simulated(model, u)
        flat = (-1, *y.shape[2:])
        found["rms_um"].append(benchmark_rms((y - error).reshape(flat), y.reshape(flat)))
        found["noise_um"].append(noise(y))
        found["position_rms_um"].append(float(np.sqrt(np.mean(y**2))))
        found["bands_um"].append(bands(error))
    return found


def cost_us(model: HammersteinModel) -> float:
    """Time of one sample [us]; the shortest of five runs."""
    block = on_grid(model.dynamics, TIME_S)
    u = 0.1 * np.random.default_rng(0).normal(size=(block.n_inputs, 50_000))
    times = []
    for _ in range(6):
        begun = time.perf_counter()
        block.respond(u)
        times.append(time.perf_counter() - begun)
    return float(1e6 * min(times[1:]) / u.shape[1])


def table(found: dict[str, dict[str, list[Any]]]) -> str:
    """Lines of the benchmark's table and of what remains in each band."""
    head = ["| rms [um] | 100 mV | 200 mV | 300 mV |", "| --- | ---: | ---: | ---: |"]
    rows = {f"published: {name}": list(values) for name, values in PUBLISHED.items()}
    rows["**this model, test records**"] = found["test"]["rms_um"]
    rows["this model, training records"] = found["train"]["rms_um"]
    rows["noise of one period, test records"] = found["test"]["noise_um"]
    rows["rms of the test positions"] = found["test"]["position_rms_um"]
    lines = [f"| {name} | {' | '.join(f'{v:.3f}' for v in values)} |" for name, values in rows.items()]
    edges = itertools.pairwise(BANDS_HZ)
    each = zip(edges, *found["test"]["bands_um"], strict=True)
    over = [
        f"| {low} to {high} | {' | '.join(f'{v:.3f}' for v in values)} |" for (low, high), *values in each
    ]
    band_head = [
        "",
        "| test error in a band [Hz] | 100 mV | 200 mV | 300 mV |",
        "| --- | ---: | ---: | ---: |",
    ]
    return "\n".join([*head, *lines, *band_head, *over]) + "\n"


def training(folder: Path) -> list[Record]:
    """Give the training records of all levels, both periods of each."""
    found = []
    for level in LEVELS_MV:
        for u, y in zip(*records(folder, level, "train"), strict=True):
            inputs, outputs = (tuple(f"{axis}{i + 1}" for i in range(len(u[0]))) for axis in "uy")
            n = u.shape[-1]
            found.append(Record(np.hstack(u), np.hstack(y), TIME_S, inputs, outputs, period_samples=n))
    return found


def fit(folder: Path, minutes: float) -> None:
    """Identify from the training records with defaults; write the model and what was tried."""
    begun, tell = time.monotonic(), partial(print, flush=True)
    model, fit = identify_in_loop(training(folder), LoopSettings(minutes=minutes), progress=tell)
    model.save(HERE / "model.json")
    tried = [{"structure": one.name, "percent": one.percent, "kept": one.kept} for one in fit.trials]
    content = {"minutes": round((time.monotonic() - begun) / 60.0), "trials": tried}
    (HERE / "trials.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def structures(tried: list[dict[str, Any]]) -> str:
    """Lines of the table of all structures; the one that was kept is bold."""
    lines = ["| structure | error on the selection experiments |", "| --- | ---: |"]
    for one in tried:
        name = f"**{one['structure']}**" if one["kept"] else one["structure"]
        lines.append(f"| {name} | {one['percent']:.3g} % |")
    return "\n".join(lines) + "\n"


def rest_um(model: HammersteinModel) -> float:
    """Rms of the last tenth of a second of two without voltage, after one of the largest records [um]."""
    u = np.zeros((len(model.inputs), round(3.0 / TIME_S)))
    driven = round(1.0 / TIME_S)
    u[:, :driven] = 1e-3 * LEVELS_MV[-1] * np.random.default_rng(0).normal(size=(len(u), driven))
    left = model.simulate(u, TIME_S).position_um[:, -round(0.1 / TIME_S) :]
    return float((left - left.mean(axis=1, keepdims=True)).std())


def write_table(folder: Path) -> None:
    """Print the table, and write the page."""
    model = HammersteinModel.load(HERE / "model.json")
    found = {part: judged(model, folder, part) for part in ("train", "test")}
    search = json.loads((HERE / "trials.json").read_text(encoding="utf-8"))
    lines = table(found)
    print(f"{lines}\n{cost_us(model):.2f} us a sample, {rest_um(model):.2g} um rms at rest")
    (HERE / "table.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    page = (HERE / "notes.md").read_text(encoding="utf-8")
    for name, words in (
        ("table", lines),
        ("structures", structures(search["trials"])),
        ("minutes", str(search["minutes"])),
    ):
        page = page.replace(f"{{{name}}}", words)
    (HERE / "README.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["table", folder]:
            write_table(Path(folder))
        case ["fit", folder, *minutes]:
            fit(Path(folder), float(minutes[0]) if minutes else 60.0)
        case _:
            sys.exit(__doc__)
