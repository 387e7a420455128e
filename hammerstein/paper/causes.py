"""Causes of unmet claims: the simulated figure with one or two factors changed."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, NamedTuple

from hammerstein.blocks.instruments import Instruments
from hammerstein.compensators import InverseMultiplicative
from hammerstein.errors import HammersteinError
from hammerstein.experiment.case_cache import CaseCache
from hammerstein.experiment.measure import empty_rows_of
from hammerstein.experiment.set_up import plant_of, set_up
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.paper.claims import Claim, FactorName
from hammerstein.paper.judgements import Change
from hammerstein.quantities import sampling
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario
from hammerstein.scenario.source import ClosedFormSpec, ModelSource

PASSES = 16  # of the paper's law, if one is not enough
FINER = 4  # divisor of the sample time
LOW_HZ = 10.0
"""Frequency at which resonance and sensor have no effect."""


class Variation(NamedTuple):
    """One or two factors of the chain changed, both in identification and in the run.

    factors : changed factors; words : description, such as ``with an ideal sensor``
    scenario, model : changed scenario and model
    """

    factors: tuple[FactorName, ...]
    words: str
    scenario: Scenario
    model: HammersteinModel

    @property
    def factor(self) -> str:
        """Name of the change."""
        return " + ".join(self.factors)


Effect = Callable[[Scenario, HammersteinModel, Claim], Variation | None]


@dataclass(frozen=True)
class Repeats:
    """Repeats of a run, all of which a verdict must agree with.

    seeds : how many seeds of noise, that of the run itself included; finer : divisors of its sample time
    """

    seeds: int = 1
    finer: tuple[int, ...] = ()

    def of(self, scenario: Scenario, model: HammersteinModel) -> Iterator[Scenario]:
        """The scenario with each of the other seeds, then with each of the finer sample times."""
        for seed in range(scenario.seed + 1, scenario.seed + self.seeds):
            yield scenario.model_copy(update={"seed": seed})
        for parts in self.finer:
            yield finer(scenario, model, parts)


def changes_of(
    scenario: Scenario, model: HammersteinModel, claim: Claim, repeats: Repeats, store: Store | None = None
) -> Iterator[Change]:
    """Figure of a claim with each factor changed alone; NaN where it cannot be simulated.

    A change that brings agreement is repeated with other seeds and sample times. If no single factor brings
    agreement, every pair is tried, too.
    """
    own, enough = _of_claim(scenario, claim), False
    for variation in variations(own, model, claim):
        change = _change(variation, claim, repeats, store)
        enough |= change.agrees
        yield change
    for variation in () if enough else pairs(own, model, claim):
        yield _change(variation, claim, repeats, store)


def _change(variation: Variation, claim: Claim, repeats: Repeats, store: Store | None) -> Change:
    """Figure of a claim with a variation; if that changes the sample time, only seeds are repeated."""
    first = _value(variation.scenario, variation.model, claim, store)
    again: Iterable[Scenario] = ()
    if claim.agreement.holds(first, claim.paper):
        kept = replace(repeats, finer=()) if "sample_time" in variation.factors else repeats
        again = kept.of(variation.scenario, variation.model)
    values = [first, *(_value(repeat, variation.model, claim, store) for repeat in again)]
    return Change.of(variation.factor, variation.words, claim, values)


def variations(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Iterator[Variation]:
    """Variations of each applicable factor alone."""
    for effect in _effects(claim):
        if (found := effect(scenario, model, claim)) is not None:
            yield found


def pairs(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Iterator[Variation]:
    """Variations of each pair of applicable factors."""
    for first, second in combinations(_effects(claim), 2):
        once = first(scenario, model, claim)
        twice = None if once is None else second(once.scenario, once.model, claim)
        if once is not None and twice is not None:
            words = f"{once.words} and {twice.words}"
            yield Variation((*once.factors, *twice.factors), words, twice.scenario, twice.model)


def _effects(claim: Claim) -> list[Effect]:
    return [effect for name, effect in EFFECTS.items() if claim.factors is None or name in claim.factors]


def _sensor(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    instruments = scenario.instruments.model_copy(update={"sensor": Instruments.ideal().sensor})
    changed = scenario.model_copy(update={"instruments": instruments})
    return Variation(("sensor",), "with an ideal sensor", changed, model)


def _dynamics(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    words = "with the dynamics removed"
    return Variation(("dynamics",), words, scenario, model.static())


def _passes(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    changed = with_passes(scenario, PASSES)
    words = f"with {PASSES} passes per sample"
    return None if changed is None else Variation(("passes",), words, changed, model)


def _sample_time(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    changed = finer(scenario, model, FINER)
    words = sampling(changed.instruments.drive.sample_time_s)
    return Variation(("sample_time",), words, changed, model)


def _amplitude(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    volts = amplitude_of_path(scenario, model, claim)
    changed = identified_with(scenario, "amplitude_v", volts) if volts < model.amplitude_v else None
    words = f"with identification at {volts:.2g} V"
    return None if changed is None else Variation(("identification_amplitude",), words, changed, model)


def _frequency(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Variation | None:
    """Not for claims that compare identification frequencies or count octaves from one."""
    tested = [s.identification for s in (*scenario.compensators, *scenario.models) if s.is_tested]
    frequencies = {spec.frequency_hz for spec in tested if isinstance(spec, ClosedFormSpec)}
    if claim.quantity.found_hz is not None or len(frequencies) != 1:
        return None
    changed = identified_with(scenario, "frequency_hz", LOW_HZ)
    words = f"with identification at {LOW_HZ:g} Hz"
    return None if changed is None else Variation(("identification_frequency",), words, changed, model)


EFFECTS: dict[FactorName, Effect] = {
    "sensor": _sensor,
    "dynamics": _dynamics,
    "passes": _passes,
    "sample_time": _sample_time,
    "identification_amplitude": _amplitude,
    "identification_frequency": _frequency,
}


def finer(scenario: Scenario, model: HammersteinModel, parts: int) -> Scenario:
    """The scenario with the converter's sample time divided."""
    own = plant_of(scenario, model).instruments.drive
    drive = own.model_copy(update={"sample_time_s": own.sample_time_s / parts})
    instruments = scenario.instruments.model_copy(update={"drive": drive})
    return scenario.model_copy(update={"instruments": instruments})


def rows_needed(
    scenario: Scenario,
    claims: Sequence[Claim],
    name: str,
    model: HammersteinModel,
    store: Store | None = None,
) -> list[Row]:
    """Rows that the claims select; only cases that contain them are simulated."""
    setup = set_up(scenario, name, model=model, store=store)
    cases = [
        case
        for case in setup.cases()
        if any(claim.selects(row) for row in empty_rows_of(setup, case) for claim in claims)
    ]
    return [row for result in CaseCache(setup, store).results(cases) for row in result.rows]


def _value(scenario: Scenario, model: HammersteinModel, claim: Claim, store: Store | None) -> float:
    try:
        return claim.value(rows_needed(scenario, [claim], claim.id, model, store))
    except HammersteinError:
        return math.nan


def _of_claim(scenario: Scenario, claim: Claim) -> Scenario:
    """The scenario with only those compensators or models that the claim names, in their positions."""
    named = {q.compensator for q in (claim.quantity, claim.over) if q is not None}
    if None in named:
        return scenario

    def change(source: ModelSource) -> ModelSource:
        return source if source.label in named else source.model_copy(update={"only_at_hz": ()})

    return _with_sources(scenario, change) or scenario


def _with_sources(scenario: Scenario, change: Callable[[Any], Any]) -> Scenario | None:
    """The scenario with every source changed; None where this changes nothing."""
    groups = {name: tuple(map(change, getattr(scenario, name))) for name in ("compensators", "models")}
    tested = (s for group in groups.values() for s in group if s.is_tested)
    before = (s for name in groups for s in getattr(scenario, name) if s.is_tested)
    return None if list(tested) == list(before) else scenario.model_copy(update=groups)


def with_passes(scenario: Scenario, passes: int) -> Scenario | None:
    """The scenario with this number of passes of the paper's law per sample; None without such a law."""

    def change(source: ModelSource) -> ModelSource:
        is_paper = isinstance(source, InverseMultiplicative)
        return source.model_copy(update={"iterations": passes}) if is_paper else source

    return _with_sources(scenario, change)


def identified_with(scenario: Scenario, key: str, value: float) -> Scenario | None:
    """The scenario with another amplitude or frequency of its closed-form identifications."""

    def change(source: ModelSource) -> ModelSource:
        spec = source.identification
        if not isinstance(spec, ClosedFormSpec):
            return source
        return source.model_copy(update={"identification": spec.model_copy(update={key: value})})

    return _with_sources(scenario, change)


def amplitude_of_path(scenario: Scenario, model: HammersteinModel, claim: Claim) -> float:
    """Voltage [V] whose settled loops reach the amplitude of the claim's path on every axis."""
    signal = next(iter(scenario.signals())).model_dump()
    if scenario.drive is not None:
        return float(claim.quantity.amplitude_v or signal.get("amplitude_v", model.amplitude_v))
    wanted = claim.quantity.amplitude_um or signal.get("amplitude_um", signal.get("radius_um", 0.0))
    low, high = 0.0, model.amplitude_v
    for _ in range(40):
        middle = 0.5 * (low + high)
        reached = model.hysteresis.amplitude(middle).diagonal().min() >= wanted
        low, high = (low, middle) if reached else (middle, high)
    return high
