"""A resonance that moves with the amplitude: one model for every level, and a path that it follows."""

import numpy as np
from matplotlib.figure import Figure

import hammerstein
from hammerstein.arrays import Array

TIME_S, SAMPLES, LEVELS_V = 1e-4, 1024, (3.0, 6.0, 12.0)


def stack() -> hammerstein.HammersteinModel:
    """Make a stack of 400 Hz from the numbers of its data sheet."""
    stops = tuple(
        hammerstein.ElastoSlip(stiffness_v_per_uc=k, threshold_uc=r)
        for k, r in ((0.3, 0.9), (0.2, 3.0), (0.1, 12.0))
    )
    axis = hammerstein.StackAxis(
        mass_kg=0.5,
        stiffness_n_per_um=3.16,
        damping_ns_per_m=120.0,
        capacitance_uf=2.0,
        force_n_per_v=1.2,
        stops=stops,
    )
    straight = hammerstein.PrandtlIshlinskii.from_arrays([0.0], [[[1.0]]])
    dynamics = hammerstein.ElectromechanicalDynamics(axes=(axis,))
    return hammerstein.HammersteinModel("stack", straight, dynamics, 50.0, ("u",), ("x",))


def multisine(seed: int, rms: float, highest: int) -> Array:
    """Return one period (1, SAMPLES) of random phases, up to a line."""
    lines = np.zeros(SAMPLES // 2 + 1, dtype=complex)
    lines[1 : highest + 1] = np.exp(2j * np.pi * np.random.default_rng(seed).uniform(size=highest))
    period = np.fft.irfft(lines)
    return np.asarray(rms * period[None] / period.std())


def recorded(actuator: hammerstein.HammersteinModel, seed: int, level_v: float) -> hammerstein.Record:
    """Record two settled periods with a noise of half a percent."""
    u = np.tile(multisine(seed, level_v, 110), 4)
    y = actuator.simulate(u, TIME_S).position_um[:, -2 * SAMPLES :]
    y = y + 0.005 * y.std() * np.random.default_rng([seed, 1]).normal(size=y.shape)
    return hammerstein.Record(u[:, -2 * SAMPLES :], y, TIME_S, period_samples=SAMPLES, source=f"{seed}")


def main() -> Figure:
    """Identify the stack at three levels, and follow a multisine beyond its resonance."""
    actuator = stack()
    records = [recorded(actuator, k, LEVELS_V[k % 3]) for k in range(6)]
    between = recorded(actuator, 50, 9.0)
    settings = hammerstein.LoopSettings(order=4, minutes=3.0)
    model, fit = hammerstein.identify_in_loop(records, settings, validation=[between])
    print(fit.verdict)

    path = np.clip(np.arange(2 * SAMPLES) / 800, 0.0, 1.0) * np.tile(multisine(7, 3.0, 60), 2)
    drive = model.compensate(path).drive_v
    error = actuator.simulate(drive, TIME_S).position_um - path
    print(f"path of {np.ptp(path):.3g} um up to 590 Hz: rms error {error[0, SAMPLES:].std():.2g} um")

    from hammerstein.reporting.figures.identified import identified_figures

    return identified_figures(fit)["residual"]


if __name__ == "__main__":
    main().savefig("hysteresis_in_loop.png")
