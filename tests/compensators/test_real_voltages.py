"""From a recording to the amplifier: voltages absolute, one-sided, offset; played on the true actuator.

The true actuator is a loop of its own here, in absolute volts; it shares nothing with the package.
"""

import json
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest

from hammerstein.commands.cli import main

RATE_HZ = 2000.0


class Actuator:
    """Plays in absolute volts that rest where the actuator was never driven; outputs are sums of them."""

    def __init__(self, rest_v, thresholds_v, weights_um_per_v):
        self.r, self.w = thresholds_v, weights_um_per_v  # (input, operator), (output, input, operator)
        self.plays = np.repeat(np.array(rest_v, dtype=float)[:, None], self.r.shape[1], axis=1)
        self.rest_um = self.position()

    def position(self):
        return np.einsum("oki,ki->o", self.w, self.plays)

    def drive(self, u_v):
        """Positions (output, sample) from where it was never driven; the memory stays."""
        out = np.empty((len(self.w), u_v.shape[1]))
        for t, u in enumerate(u_v.T):
            for k in range(len(u)):
                for i, r in enumerate(self.r[k]):
                    self.plays[k, i] = max(u[k] - r, min(u[k] + r, self.plays[k, i]))
            out[:, t] = self.position() - self.rest_um
        return out


def random_actuator(seed, inputs):
    """Range, rest and parameters of a stack or bender: one-sided, poled either way, moving either way."""
    rng = np.random.default_rng(seed)
    low = rng.choice([0.0, -20.0, -90.0, 35.0])
    span = rng.uniform(60.0, 200.0)
    low, high = (low, low + span) if rng.random() < 0.5 else (-low - span, -low)
    rest = low if rng.random() < 0.5 else high
    share = np.concatenate([[0.0], np.sort(rng.uniform(0.01, 0.42, 5))])
    r = np.tile(share * span, (inputs, 1)) * rng.uniform(0.8, 1.1, (inputs, 1))
    w = np.zeros((inputs, inputs, 6))
    for o in range(inputs):
        for k in range(inputs):
            size = rng.uniform(0.1, 1.0) * (1.0 if o == k else 0.04)
            w[o, k] = rng.choice([-1.0, 1.0]) * size * np.concatenate([[1.0], rng.uniform(0.02, 0.2, 5)])
    return low, high, Actuator([rest] * inputs, r, w)


def triangles(low, high, rest, sizes, samples=400):
    """From rest to the far end and back, each time less far."""
    far = high if rest == low else low
    tips = [rest]
    for size in sizes:
        tips += [rest + size * (far - rest), rest + 0.3 * (1.0 - size) * (far - rest)]
    steps = [np.linspace(a, b, samples, endpoint=False) for a, b in pairwise(tips)]
    return np.concatenate([*steps, [tips[-1]]])


def write_records(folder, actuator, low, high, rng, noise, dead=40):
    """One record an input, the others held where they rest, and one for validation; columns called alike."""
    rest = actuator.plays[:, 0].copy()
    paths = []
    for number, sizes in enumerate([(1.0, 0.3, 0.6, 0.8, 1.0)] * len(rest) + [(0.95, 0.5, 0.7)]):
        actuator.plays[:] = rest[:, None]
        wave = triangles(low, high, rest[0], sizes)
        u = np.repeat(rest[:, None], len(wave), axis=1)
        for k in range(len(rest)):
            if number in (k, len(rest)):
                u[k] = wave if number < len(rest) else np.roll(wave, 0)
        u = np.hstack([np.repeat(u[:, :1], dead, axis=1), u])
        y = actuator.drive(u)
        y = y + 17.0 + noise * np.ptp(y, axis=1, keepdims=True) * rng.standard_normal(y.shape)
        path = folder / f"record_{number}.csv"
        header = ",".join(["Volt"] * len(rest) + ["Position"] * len(rest))
        np.savetxt(path, np.vstack([u, y]).T, delimiter=",", header=header, comments="")
        paths.append(path)
    return paths, rest


def call(*arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code or 0


def read_drive(path, inputs):
    table = pd.read_csv(path, comment="#")
    assert table.shape[1] == 1 + 3 * inputs
    assert len(set(table.columns)) == table.shape[1]
    return (table.filter(like=word).to_numpy().T for word in ("drive_", "reference_", "predicted_"))


def path_within(reach_um, samples=4000):
    """A smooth path of three cycles with falling and rising size inside an interval of positions."""
    t = np.arange(samples) / samples
    low, high = 0.05 * np.diff(reach_um)[0] + reach_um[0], reach_um[1] - 0.05 * np.diff(reach_um)[0]
    grow = np.minimum(4.0 * t, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(4.0 * t, 1.0))
    middle, size = 0.5 * (low + high), 0.5 * (high - low)
    return grow * (middle - size * np.cos(2.0 * np.pi * 3.0 * t) * (1.0 - 0.4 * t))


# One input and two, poled either way, resting at either end, moving either way: 1 and 2 are all of it.
LENGTHY = [pytest.param(seed, marks=pytest.mark.long) for seed in (0, *range(3, 8))]
TWO_INPUTS = pytest.param(2, marks=pytest.mark.full)


@pytest.fixture(scope="module", params=[1, TWO_INPUTS, *LENGTHY])
def identified(request, tmp_path_factory):
    """Model file of an actuator drawn at random, found by the defaults, and its error held back."""
    seed, folder = request.param, tmp_path_factory.mktemp(f"seed_{request.param}")
    rng = np.random.default_rng(100 + seed)
    inputs = 1 + seed % 2
    low, high, actuator = random_actuator(seed, inputs)
    records, rest = write_records(folder, actuator, low, high, rng, noise=2e-4)
    columns = (
        ",".join(str(k + 1) for k in range(inputs)),
        ",".join(str(inputs + k + 1) for k in range(inputs)),
    )
    model = folder / "stage.json"
    options = ("--inputs", columns[0], "--outputs", columns[1], "--rate", RATE_HZ, "--no-figures")
    assert call("identify", *records[:-1], *options, "--validate", records[-1], "--out", model) == 0
    fit = json.loads((folder / "stage_fit" / "fit.json").read_text())
    held_um = np.array(fit["validation"][fit["kind"]]["rms_um"])
    return model, held_um, low, high, actuator, rest


@pytest.mark.parametrize("conditioned", [False, True])
def test_from_record_to_amplifier(identified, tmp_path, capsys, conditioned):
    model, held_um, low, high, actuator, rest = identified
    inputs = len(rest)
    actuator.plays[:] = rest[:, None]
    for sizes in ((1.0, 0.3, 0.6, 0.8, 1.0), (0.95, 0.5, 0.7)):
        actuator.drive(np.repeat(triangles(low, high, rest[0], sizes)[None], inputs, axis=0))
    after_the_records = actuator.plays.copy()
    content = json.loads(model.read_text())
    assert content["format"] == "hammerstein-model/2"
    voltages = content["voltages"]
    assert voltages["working_point_v"] == pytest.approx(list(rest), abs=1e-9)
    assert voltages["lowest_v"] == pytest.approx([low] * inputs, abs=1e-9)
    assert voltages["highest_v"] == pytest.approx([high] * inputs, abs=1e-9)
    one_sided = (
        {True: "positive", False: "negative"}[high > -low]
        if min(high, -low) <= 0.25 * max(high, -low)
        else "both"
    )
    assert voltages["poling"] == [one_sided] * inputs

    # What slow paths reach, asked for before with a path that stands still.
    start = [float(rest[0] + 0.05 * (0.5 * (low + high) - rest[0]))] * inputs
    terms = [
        "--law",
        "exact_inverse",
        "--start",
        ",".join(f"{u!r}" for u in start),
        *["--conditioned"] * conditioned,
    ]
    time_s = np.arange(4000) / RATE_HZ
    still = pd.DataFrame({"time_s": time_s, **{f"p{o}": 0.0 * time_s for o in range(inputs)}})
    still.to_csv(tmp_path / "still.csv", index=False)
    out = tmp_path / "drive.csv"
    assert call("compensate", model, tmp_path / "still.csv", "--out", out, *terms, "--json") == 0
    axes = json.loads(capsys.readouterr().out)["axes"].values()
    wanted = [path_within(0.8 * np.array(axis["reach_together_um"])) for axis in axes]
    pd.DataFrame({"time_s": time_s} | {f"p{o}": p for o, p in enumerate(wanted)}).to_csv(
        tmp_path / "path.csv", index=False
    )
    assert call("compensate", model, tmp_path / "path.csv", "--out", out, *terms) == 0

    drive, reference, predicted = read_drive(out, inputs)
    np.testing.assert_allclose(reference, wanted, atol=1e-12)
    assert (drive >= low).all()
    assert (drive <= high).all()
    np.testing.assert_allclose(drive[:, 0], start, atol=0.02 * (high - low))

    actuator.plays[:] = after_the_records if conditioned else rest[:, None]
    before = [[high] * inputs, [low] * inputs, start] if conditioned else [start]
    begin = actuator.drive(np.array(before).T)[:, -1:]
    position = actuator.drive(drive) - begin
    error = np.sqrt(np.mean((position - reference) ** 2, axis=1))
    assert (error <= 3.0 * held_um).all(), (error, held_um)
    np.testing.assert_allclose(predicted, reference, atol=1e-6)
