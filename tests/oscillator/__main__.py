"""Identify the Bouc-Wen oscillator of the literature with a loop that does not know its equation.

    python -m tests.oscillator

It simulates the records, fits, prints the error on two records that were not fitted, and writes results.json
beside this file: the numbers of the fit, so that a test can judge them anew.

The fit knows dynamics of order 2 with a rate-independent hysteresis in their loop, whose slope is an unknown
function of where it stands (Duhem's kind, 8 values). That is neither the oscillator's equation nor a number
of it; all values come from the records.
"""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np

from hammerstein.dynamics import FeedbackBlock
from hammerstein.identification.in_loop.parameters import SettledPeriod
from hammerstein.identification.in_loop.search import OpenLoop, fit_loop
from hammerstein.identification.linear.frequency_response import measured_response
from hammerstein.identification.linear.state_space import fit_state_space
from hammerstein.records.record import Record

from .duhem import Duhem
from .oscillator import RATE_HZ, multisine, sweep

RESULTS = Path(__file__).with_name("results.json")
FITTED_N = ((1, 50.0), (2, 20.0))
"""Seeds and rms of the multisines of SAMPLES that are fitted [N]."""
SAMPLES = 2048
UNSEEN = 99, 50.0
KNOTS = 8
"""Even, so that none lies at w = 0, where the slope of the oscillator has its corner."""
WARM = 500
MM = 1e3


def start(records):
    """Linear dynamics of the records; half of the stiffness is given to a hysteresis that is a line yet."""
    linear = fit_state_space(measured_response(records), 2)
    to = np.vstack([linear.C, linear.C @ linear.A])  # y and y of the next sample are the states
    a = np.linalg.solve(to.T, (to @ linear.A).T).T
    held = 0.5 * (1.0 - a[1].sum())
    a[1, 0] += held
    reach = max(float(np.abs(record.y_um).max()) for record in records)
    block = FeedbackBlock(
        A=a, B=to @ linear.B, C=np.eye(2)[:1], D=linear.D, E=np.array([[0.0], [-held]]), F=np.eye(2)[:1],
        G=np.zeros((1, 1)), hysteresis=Duhem((1.0,) * KNOTS, reach), sample_time_s=1.0 / RATE_HZ,
    )  # fmt: skip
    free = {
        "A": [[False, False], [True, True]],
        "B": [[True], [True]],
        "D": [[True]],
        "E": [[True], [True]],
        "F": [[False, True]],
        "G": [[True]],
    }
    return OpenLoop(block, {name: np.array(entries) for name, entries in free.items()})


def record(seed, rms_n, samples):
    u, y = multisine(seed, rms_n, samples)
    return Record(u[None], MM * y[None], 1.0 / RATE_HZ, source=f"multisine {seed}", period_samples=len(u))


def decibels(error_mm):
    """Of the rms of an error, of 1 m."""
    return float(20.0 * np.log10(np.sqrt(np.mean(error_mm**2)) / MM))


def judged(loop):
    """What is left of a multisine and of a sweep that were not fitted [dB of 1 m]."""
    unseen, (u, y) = record(*UNSEEN, 8192), sweep()
    settled = SettledPeriod(unseen.u_v, unseen.y_um, 1.0, WARM)
    swept = SettledPeriod(u[None], MM * y[None], 1.0, 0)
    return {"multisine_db": decibels(loop.error(settled)), "sweep_db": decibels(loop.error(swept))}


def main():
    records = [record(*one, SAMPLES) for one in FITTED_N]
    begun = start(records)
    periods = [SettledPeriod(r.u_v, r.y_um, 1.0 / float(r.y_um.std()), WARM) for r in records]
    clock, best = time.monotonic(), [np.inf, 0]

    def tell(rms):
        best[1] += 1
        if rms < 0.9 * best[0]:
            best[0] = rms
            print(
                f"{best[1]} simulations, {time.monotonic() - clock:.0f} s: {100 * rms:.3g} % left", flush=True
            )

    found = fit_loop(begun, periods, tell)
    numbers = found.vector()
    result = {"numbers": numbers.tolist(), "linear": judged(begun), "found": judged(found)}
    print(f"{len(numbers)} numbers; linear {result['linear']}; found {result['found']}")
    RESULTS.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
