"""From CSV files to a model: ``hammerstein init`` has made record_x.csv and record_y.csv."""

from matplotlib.figure import Figure

import hammerstein


def main() -> Figure:
    """Identify a model with dynamics, say how far to trust it, and draw measured and modelled loops."""
    records = hammerstein.read_records(
        ["record_x.csv", "record_y.csv"], inputs=["u_x", "u_y"], outputs=["x", "y"], time="time_s"
    )
    model, fit = hammerstein.identify(records, hammerstein.Settings(dynamics="second_order"))
    print(fit.verdict)
    print(model.hysteresis.gain(10.0).round(2), "um/V")
    model.save("identified.json")

    from hammerstein.reporting.figures.identified import identified_figures

    return identified_figures(fit)["loops"]


if __name__ == "__main__":
    main().savefig("identify_csv.png")
