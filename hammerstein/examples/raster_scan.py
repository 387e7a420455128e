"""A raster scan with flyback, plane by plane: triangles on x, steps on y, the error at every plane."""

import numpy as np
from matplotlib.figure import Figure

import hammerstein

T, LINE_S, PLANES, STEP_UM, WIDTH_UM, FLYBACK = 50e-6, 0.05, 6, 4.0, 30.0, 0.2


def main() -> Figure:
    """Scan, and measure where each line lies that should lie still."""
    samples = round(LINE_S / T)
    phase = np.arange(PLANES * samples) / samples
    inside, plane = phase % 1.0, np.floor(phase)
    up = 1.0 - FLYBACK
    x = WIDTH_UM * np.where(inside < up, inside / up, (1.0 - inside) / FLYBACK)
    eased = np.clip((inside - up) / FLYBACK, 0.0, 1.0)
    y = STEP_UM * (plane + eased**2 * (3.0 - 2.0 * eased))
    actuator = hammerstein.HammersteinModel.load("duo_bimorph")
    path = [x - WIDTH_UM / 2, y - y.mean()]
    found = actuator.compensate(path, law="hammerstein_inverse", filter_hz=300.0, clip=True)
    position = actuator.simulate(found.drive_v, T).position_um
    error = position - found.reference_um
    for number in range(PLANES):
        line = (plane == number) & (inside > 0.1 * up) & (inside < 0.9 * up)
        rms = np.sqrt(np.mean(error[:, line] ** 2, axis=1))
        print(f"plane {number}: {rms[0]:.3f} um along the line, {rms[1]:.3f} um across")
    figure = Figure(layout="constrained")
    axes = figure.subplots()
    axes.plot(*found.reference_um, color="0.7", linewidth=3.0, label="reference")
    axes.plot(*position, linewidth=1.0, label="position")
    axes.set(xlabel="x [um]", ylabel="y [um]")
    axes.legend()
    return figure


if __name__ == "__main__":
    main().savefig("raster_scan.png")
