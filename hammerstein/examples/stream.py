"""Drive a device sample by sample: a 60 Hz circle through the exact inverse, and how late each sample was.

The device is simulated; put your own ``write`` in its place. Run: ``python -m hammerstein.examples.stream``.
"""

import gc
import time

import numpy as np

import hammerstein
from hammerstein.arrays import Array

SAMPLE_TIME_S = 500e-6
SECONDS = 2.0
EDGES_US = (0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10_000)


class SimulatedDevice:
    """Takes voltages, as an amplifier would; afterwards the model says where the actuator went."""

    def __init__(self, model: hammerstein.HammersteinModel, samples: int):
        self.model, self.sent, self.count = model, np.empty((2, samples)), 0

    def write(self, drive_v: Array) -> None:
        """Send voltages (m,)."""
        self.sent[:, self.count] = drive_v
        self.count += 1

    def position_um(self) -> Array:
        """Where the actuator was (p, N)."""
        return self.model.simulate(self.sent[:, : self.count], SAMPLE_TIME_S).position_um


def circle(samples: int) -> Array:
    """A 20 um circle of 60 Hz that grows in 50 ms (p, N)."""
    time_s = SAMPLE_TIME_S * np.arange(samples)
    turn, radius = 2.0 * np.pi * 60.0 * time_s, 20.0 * np.minimum(1.0, time_s / 0.05)
    return np.stack([radius * np.sin(turn), radius * np.cos(turn)])


def follow(loop: hammerstein.Stream, reference_um: Array, device: SimulatedDevice) -> tuple[Array, Array]:
    """Send one sample after the other when it is due; work and lateness of each (N,) [s]."""
    samples = reference_um.shape[1]
    rows = np.ascontiguousarray(reference_um.T)
    work, late = np.empty(samples), np.empty(samples)
    gc.collect()
    gc.freeze()  # what is there already is never looked at again
    begin = time.perf_counter()
    for k in range(samples):
        due = begin + k * SAMPLE_TIME_S
        while time.perf_counter() < due:
            pass  # a real device waits here for its clock
        woken = time.perf_counter()
        device.write(loop.step(rows[k]))
        now = time.perf_counter()
        work[k], late[k] = now - woken, now - due
    gc.unfreeze()
    return work, late


def histogram(name: str, times_s: Array) -> list[str]:
    """Lines of a histogram of times."""
    times_us = 1e6 * times_s
    counts, _ = np.histogram(times_us, (*EDGES_US, np.inf))
    lines = [f"{name}: median {np.median(times_us):.1f} us, worst {times_us.max():.0f} us"]
    for low, count in zip(EDGES_US, counts, strict=True):
        lines.append(f"from {low:6d} us {count:7d} {'#' * round(60 * count / len(times_us))}")
    return lines


def main(seconds: float = SECONDS) -> None:
    """Follow the circle, then print how long and how late, and the error."""
    model = hammerstein.HammersteinModel.load("duo_bimorph_static")
    law = hammerstein.ExactInverse().design(model, range_v=10.0, sample_time_s=SAMPLE_TIME_S)
    reference = circle(round(seconds / SAMPLE_TIME_S))
    device, loop = SimulatedDevice(model, reference.shape[1]), hammerstein.stream(law)
    work, late = follow(loop, reference, device)
    for line in (*histogram("time a step", work), *histogram("late after its time", late)):
        print(line)
    error = device.position_um() - reference
    print(f"error of the simulated actuator: {np.sqrt(np.mean(error**2)):.2g} um rms")


if __name__ == "__main__":
    main()
