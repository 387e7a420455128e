"""Models and laws whose C code is tested: of every law, and of what makes each of them different."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.blocks.voltages import Voltages
from hammerstein.dynamics import (
    AxesDynamics,
    Axis,
    CreepMode,
    FeedbackHysteresisDynamics,
    StateSpaceDynamics,
    StaticDynamics,
)
from hammerstein.dynamics.feedback_block import InputProducts
from hammerstein.export.code import CCode
from hammerstein.export.request import Request
from hammerstein.hysteresis import (
    Asymmetric,
    BoucWen,
    BoucWenPair,
    DeadZones,
    Envelope,
    Generalised,
    Pair,
    Parallel,
    PrandtlIshlinskii,
    Preisach,
    RateDependent,
    RatePlays,
)
from hammerstein.model import HammersteinModel

T = 50e-6


def duo_bimorph():
    return HammersteinModel.load("duo_bimorph")


def stage(working_point_v=0.0, smallest_v=0.4):
    """One axis from 0 to 120 V, with creep and an input delay of two samples."""
    pair = Pair([smallest_v, 8.0, 20.0, 45.0], [0.4, 0.2, 0.15, 0.1])
    creep = (CreepMode(gain=0.05, time_constant_s=0.3),)
    axis = AxesDynamics(
        axes=(Axis(resonance_hz=180.0, damping_ratio=0.05, creep=creep),), input_delay_s=2 * T
    )
    return HammersteinModel(
        "one stage",
        PrandtlIshlinskii([[pair]]),
        axis,
        60.0,
        ("u",),
        ("x",),
        instruments=Instruments(drive=Drive(range_v=(0.0, 120.0))),
        voltages=Voltages.of([working_point_v], [0.0], [120.0]),
    )


def loop(curved=False, moves=1, gamma=None):
    """Two axes with hysteresis, and products of what drives it, in the loop of a state space of order five.

    moves : of the hysteresis in a sample; gamma : plays if not given
    """
    grid, absent = [0.0, 0.4, 1.5], Pair.absent()
    gamma = gamma or PrandtlIshlinskii(
        [
            [Pair(grid, [0.1, 0.05, 0.02]), absent, Pair([0.0, 2.0], [0.03, 0.02])],
            [absent, Pair(grid, [0.08, 0.03, 0.01]), absent],
        ]
    )
    rng, h = np.random.default_rng(7), gamma.n_inputs
    shapes = {"B": (5, 2), "C": (2, 5), "D": (2, 2)}
    shapes |= {"E": (5, 2 * moves), "F": (h * moves, 5), "G": (h * moves, 2)}
    if moves == 2:
        shapes["H"] = h, 2
    matrices = {name: 0.2 * rng.normal(size=shape) for name, shape in shapes.items()}
    terms = np.array([[0, 1, 3], [2, 2, 2]])
    products = InputProducts(np.array([[0.1, 0.2], [-0.1, 0.05]]), np.array([3.0, 2.0, 4.0]), terms)
    dynamics = FeedbackHysteresisDynamics.of(
        gamma, sample_time_s=T, products=products if curved else None, A=0.4 * np.eye(5), **matrices
    )
    one = [[Pair([0.0], [float(i == k)]) for k in range(2)] for i in range(2)]
    return HammersteinModel("loop", PrandtlIshlinskii(one), dynamics, 10.0, tuple("ab"), tuple("xy"))


def three_inputs():
    """Three inputs, two outputs, every pair with thresholds of its own; one pair is absent."""
    rng = np.random.default_rng(5)
    grids = [np.array([0.0, 1.0, 3.0]), np.array([0.2, 0.9, 2.0, 6.0]), np.array([0.0, 5.0])]
    rows = [
        [Pair(grid, sign * rng.uniform(0.5, 1.5, len(grid))) for grid, sign in zip(grids, signs, strict=True)]
        for signs in ((1.0, 0.05, 0.4), (0.05, 1.0, 0.4))
    ]
    rows[0][1] = Pair.absent()
    a = [[0.5, 0.1, 0.0], [0.0, 0.4, 0.0], [0.0, 0.1, 0.3]]
    dynamics = StateSpaceDynamics(
        A=a, B=[[0.4, 0.0], [0.0, 0.6], [0.1, 0.0]], C=[[1.0, 0.0, 0.1], [0.0, 1.0, 0.0]],
        D=[[0.0, 0.0], [0.0, 0.0]], sample_time_s=T,
    )  # fmt: skip
    return HammersteinModel(
        "three in, two out", PrandtlIshlinskii(rows), dynamics, 10.0, tuple("abc"), tuple("xy")
    )


def asymmetric(smallest_v=0.0, working_point_v=40.0):
    """Two axes around 40 V whose plays stand beside dead-zones of their own; one input has none on y."""
    grid = np.array([smallest_v, 6.0, 20.0])
    plays = PrandtlIshlinskii(
        [[Pair(grid, [0.3, 0.1, 0.05]), Pair(grid, [0.02, 0.0, 0.01])],
         [Pair(grid, [0.01, 0.02, 0.0]), Pair(grid, [0.25, 0.1, 0.08])]]
    )  # fmt: skip
    zones = [
        [DeadZones([20.0, 70.0], [0.06, -0.03]), DeadZones.absent()],
        [DeadZones([55.0], [0.02]), DeadZones([10.0, 50.0, 90.0], [0.03, 0.05, -0.02])],
    ]
    return HammersteinModel(
        "asymmetric stage",
        Asymmetric(plays, zones, np.full(2, working_point_v)),
        AxesDynamics(axes=(Axis(resonance_hz=300.0, damping_ratio=0.05),) * 2),
        50.0,
        ("u", "w"),
        ("x", "y"),
        instruments=Instruments(drive=Drive(range_v=(0.0, 120.0))),
        voltages=Voltages.of([working_point_v] * 2, [0.0] * 2, [120.0] * 2),
    )


def generalised(tangent_v=0.0, lines=3):
    """Two axes around 40 V whose plays see envelopes of so many lines, with a tangent or not, and of one."""
    around, ends = asymmetric(), [-20.0, 30.0, 70.0, 140.0]
    voltages = np.interp(np.linspace(0.0, 3.0, lines + 1), range(4), ends)
    values = np.interp(voltages, ends, [-20.0, 30.0, 90.0, 150.0])
    bent = Envelope(voltages, values, tangent_v, 0.05, 55.0)
    straight = Envelope([0.0, 100.0], [0.0, 80.0])
    return replace(
        around, name="bent stage", hysteresis=Generalised((bent, straight), around.hysteresis.plays)
    )


def preisach():
    """Two axes around 40 V with planes of other sides and ends, which the range of the drive leaves."""
    around, rng = asymmetric(), np.random.default_rng(9)
    rows = []
    for o in range(2):
        sides = (7, 12)
        own = [np.tril(rng.uniform(0.0, 0.6 / n, (n, n))) + 0.2 * np.eye(n) for n in sides]
        rows.append([cells if o == k else 0.05 * cells for k, cells in enumerate(own)])
    block = Preisach([0.0, 10.0], [110.0, 120.0], rows)
    return replace(around, name="relay stage", hysteresis=block)


def rate_dependent(flattening=0.0, bandwidth_hz=400.0):
    """Two inputs with other plays each, whose thresholds grow with the rate."""
    inputs = (
        RatePlays([0.0, 1.0, 4.0], [0.0, 1e-4, 3e-4], bandwidth_hz=bandwidth_hz, lambda_s_per_v=flattening),
        RatePlays([0.0, 2.0], [0.0, 2e-4], bandwidth_hz=700.0),
    )
    weights = (([1.0, 0.3, 0.2], [0.05, 0.02]), ([0.1, 0.0, 0.05], [1.2, 0.4]))
    axes = AxesDynamics(axes=(Axis(resonance_hz=500.0, damping_ratio=0.05), Axis()))
    return HammersteinModel("fast stage", RateDependent(inputs, weights), axes, 10.0, ("u", "w"), ("x", "y"))


def bouc_wen():
    """Two inputs; one pair falls slower than it grows, one faster, and one is linear."""
    pairs = [
        [BoucWenPair(2.0, 0.8, 0.4, 0.3), BoucWenPair(0.1, -0.05, 0.2, 0.5)],
        [BoucWenPair(0.15), BoucWenPair(1.6, 0.3, 2.5, -1.0)],
    ]
    axes = AxesDynamics(axes=(Axis(resonance_hz=400.0, damping_ratio=0.1), Axis()))
    return HammersteinModel("soft stage", BoucWen(pairs), axes, 10.0, ("u", "w"), ("x", "y"))


def parallel():
    """All kinds side by side, and one of them twice, around a working point."""
    around = asymmetric(working_point_v=2.0)
    parts = (
        around.hysteresis,
        rate_dependent(flattening=1e-3).hysteresis,
        bouc_wen().hysteresis,
        asymmetric(smallest_v=1.5).hysteresis.plays,
        generalised(20.0).hysteresis,
        preisach().hysteresis,
    )
    return replace(
        around,
        name="all at once",
        hysteresis=Parallel(parts),
        instruments=Instruments(drive=Drive(range_v=(-8.0, 12.0))),
        voltages=Voltages.of([2.0, 2.0], [-8.0, -8.0], [12.0, 12.0]),
        amplitude_v=10.0,
    )


def static(model):
    return replace(model, dynamics=StaticDynamics(n_outputs=model.hysteresis.n_outputs))


@dataclass(frozen=True)
class Export:
    """A case by its name: model, law, and fields of the request."""

    name: str
    model: HammersteinModel
    law: str
    given: dict = field(default_factory=dict)

    def request(self, **more):
        return Request(source="model.json", law=self.law, sample_time_s=T, **self.given | more)

    def code(self, **more):
        request = self.request(**more)
        return CCode(request, self.model, request.block(self.model))


def _cases():
    two, one = duo_bimorph(), stage()
    for law in (
        "none",
        "inverse_multiplicative",
        "decoupled_inverse",
        "exact_inverse",
        "hammerstein_inverse",
        "model",
    ):
        yield Export(law, two, law)
    yield Export("filtered", two, "hammerstein_inverse", {"options": {"filter_hz": 900.0}})
    yield Export("late", two, "hammerstein_inverse", {"options": {"preview_s": 0.0, "filter_hz": 2000.0}})
    yield Export("softened", two, "exact_inverse", {"options": {"softening_v": 0.5}})
    several = {"iterations": 3, "filter_s": 2e-4}
    yield Export("passes", two, "inverse_multiplicative", {"options": several, "range_v": (-8.0, 9.0)})
    begun = {"start_v": (30.0,), "conditioned": True}
    for law in (
        "none",
        "inverse_multiplicative",
        "decoupled_inverse",
        "exact_inverse",
        "hammerstein_inverse",
    ):
        yield Export(f"started {law}", one, law, begun)
    yield Export("delayed model", one, "model")
    yield Export("away from rest", stage(working_point_v=40.0), "exact_inverse", {"start_v": (40.0,)})
    yield Export("model away from rest", stage(working_point_v=40.0), "model")
    for law in ("exact_inverse", "none", "model", "hammerstein_inverse"):
        yield Export(f"three inputs {law}", three_inputs(), law)
    yield Export("static", static(two), "hammerstein_inverse")
    yield Export("asymmetric model", asymmetric(), "model")
    yield Export("asymmetric model behind plays", asymmetric(smallest_v=1.5, working_point_v=0.0), "model")
    for law in ("exact_inverse", "hammerstein_inverse"):
        yield Export(f"asymmetric {law}", asymmetric(), law, {"start_v": (20.0, 60.0)})
    behind = asymmetric(smallest_v=1.5, working_point_v=0.0)
    yield Export("asymmetric behind plays", behind, "exact_inverse", {"options": {"softening_v": 0.5}})
    yield Export("generalised model", generalised(), "model")
    for law in ("exact_inverse", "hammerstein_inverse"):
        yield Export(f"generalised {law}", generalised(), law, {"start_v": (20.0, 60.0)})
    yield Export("saturating model", generalised(20.0), "model")
    for law in ("exact_inverse", "hammerstein_inverse"):
        yield Export(f"saturating {law}", generalised(20.0), law, {"start_v": (20.0, 60.0)})
    yield Export("saturating exact_inverse of 13 lines", generalised(20.0, 13), "exact_inverse")
    yield Export("preisach model", preisach(), "model")
    for law in ("exact_inverse", "hammerstein_inverse"):
        yield Export(f"preisach {law}", preisach(), law, {"start_v": (20.0, 60.0)})
    yield Export("rate-dependent model", rate_dependent(), "model")
    yield Export("flattening model", rate_dependent(flattening=1e-3), "model")
    slower = rate_dependent(flattening=1e-3, bandwidth_hz=200.0)
    for law in ("exact_inverse", "hammerstein_inverse"):
        yield Export(f"rate-dependent {law}", rate_dependent(), law)
        yield Export(f"flattening {law}", slower, law, {"start_v": (3.0, -2.0)})
    yield Export("bouc-wen model", bouc_wen(), "model")
    yield Export("parallel model", parallel(), "model")
    yield Export("loop model", loop(), "model")
    yield Export("curved loop model", loop(curved=True), "model")
    yield Export("loop model that moves twice", loop(curved=True, moves=2), "model")
    inside = asymmetric(), generalised(20.0), preisach(), slower, bouc_wen(), parallel()
    for model in inside:
        yield Export(
            f"{model.hysteresis.kind} in a loop",
            loop(gamma=model.hysteresis.counted_from([0.0, 0.0])),
            "model",
        )
    yield Export("bouc_wen twice in a loop", loop(moves=2, gamma=bouc_wen().hysteresis), "model")
    others = {
        "asymmetric": asymmetric(),
        "generalised": generalised(),
        "preisach": preisach(),
        "rate-dependent": slower,
        "bouc-wen": bouc_wen(),
        "parallel": parallel(),
    }
    for kind, model in others.items():
        yield Export(f"{kind} none", model, "none")
        yield Export(f"{kind} inverse_multiplicative", model, "inverse_multiplicative")
    yield Export(
        "bouc-wen passes", bouc_wen(), "inverse_multiplicative", {"options": several, "start_v": (4.0, 1.0)}
    )


CASES = tuple(_cases())
NAMES = [case.name for case in CASES]


def case(name):
    return CASES[NAMES.index(name)]


VARIANTS = (
    "started",
    "three inputs",
    "saturating",
    "flattening",
    "behind",
    "delayed",
    "away",
    "twice",
    "hammerstein",
    "preisach exact",
)
"""Words of cases that run with ``--full``: variants whose loops a compiler makes anew."""


def marked(name):
    """A case, or one that runs with ``--full``."""
    late = any(word in name for word in VARIANTS) and name != "hammerstein_inverse"
    return pytest.param(name, marks=pytest.mark.full) if late else name
