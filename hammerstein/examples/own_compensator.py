"""A compensator of one's own: the exact inverse of a model whose gain is wrong."""

from dataclasses import replace
from typing import Any, Literal

from matplotlib.figure import Figure
from pydantic import Field

import hammerstein
from hammerstein import HammersteinModel, PrandtlIshlinskii
from hammerstein.blocks import Law
from hammerstein.blocks.driving import RangeLike


@hammerstein.register
class Scaled(hammerstein.Compensator):
    """The exact inverse of a model whose weights are all scaled: what does a wrong gain cost?"""

    law: Literal["scaled"] = "scaled"
    factor: float = Field(default=1.05, ge=0.5, le=2.0, description="of all weights")

    def design(self, model: HammersteinModel, range_v: RangeLike, sample_time_s: float) -> Law[Any]:
        """Design the inverse of the scaled model."""
        assert isinstance(model.hysteresis, PrandtlIshlinskii)
        weights = [self.factor * rows for rows in model.hysteresis.weights]
        scaled = replace(model, hysteresis=model.hysteresis.with_weights(weights))
        return hammerstein.ExactInverse().design(scaled, range_v, sample_time_s)


def main() -> Figure:
    """Compare it with the exact inverse."""
    report = hammerstein.run(
        {
            "question": "What does a gain that is 5 % wrong cost?",
            "actuator": "duo_bimorph_static",
            "reference": {"kind": "sine", "amplitude_um": 30.0, "frequency_hz": 20.0},
            "compensators": [
                {"label": "exact", "law": "exact_inverse", "model": "duo_bimorph_static"},
                {"label": "5 % wrong", "law": "scaled", "model": "duo_bimorph_static"},
            ],
        }
    )
    print(report.to_frame().groupby("compensator")["max_true_um"].max())

    from hammerstein.reporting.figures import figures_of

    return figures_of(report)["errors"]


if __name__ == "__main__":
    main().savefig("own_compensator.png")
