"""When does a loop with integral control begin to swing? The describing function answers."""

import control
import numpy as np
from matplotlib.figure import Figure

import hammerstein


def main() -> Figure:
    """Draw the amplitude of the limit cycle against the gain of the integrator."""
    hysteresis = hammerstein.HammersteinModel.load("duo_bimorph_static").hysteresis
    assert isinstance(hysteresis, hammerstein.PrandtlIshlinskii)
    pair = hammerstein.PrandtlIshlinskii(((hysteresis.pairs[0][0],),))
    nonlinearity = pair.to_describing_function(range_v=10.0)
    axis = control.tf(hammerstein.cantilever(430.0, 0.12))
    gains, amplitudes = [], []
    for gain in np.linspace(40.0, 200.0, 9):
        cycles = hammerstein.limit_cycles(nonlinearity, axis * control.tf([gain], [1.0, 0.0]))
        for cycle in cycles:
            print(f"gain {gain:g} V/(um s): {cycle}")
            gains.append(gain)
            amplitudes.append(cycle.amplitude_v)
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.plot(gains, amplitudes, "o")
    axes.set(xlabel="gain of the integrator [V/(um s)]", ylabel="amplitude of the limit cycle [V]")
    return figure


if __name__ == "__main__":
    main().savefig("limit_cycle.png")
