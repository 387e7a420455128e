"""Why a claim is not met: the same figure with one factor of the chain changed at a time."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from hammerstein.blocks.instruments import Drive, Instruments
from hammerstein.compensators import InverseMultiplicative
from hammerstein.errors import HammersteinError
from hammerstein.experiment.kept import KeptCases
from hammerstein.experiment.measure import empty_rows_of
from hammerstein.experiment.set_up import set_up
from hammerstein.metrics import Row
from hammerstein.model import HammersteinModel
from hammerstein.paper.claims import Claim, FactorName
from hammerstein.paper.judgements import Change
from hammerstein.runtime.store import Store
from hammerstein.scenario import Scenario
from hammerstein.scenario.source import ClosedFormSpec, ModelSource

PASSES = 16
FINER = 4  # parts of a sample
LOW_HZ = 10.0


@dataclass(frozen=True)
class Variation:
    """One factor changed, in identification and run alike.

    words : what was done; scenario : how it is done; None where it changes nothing
    """

    factor: FactorName
    words: str
    scenario: Scenario | None
    model: HammersteinModel


def changes_of(
    scenario: Scenario, model: HammersteinModel, claim: Claim, store: Store | None = None
) -> Iterator[Change]:
    """What the figure of a claim becomes with each factor changed alone; NaN where it cannot be simulated."""
    for variation in variations(_of_claim(scenario, claim), model, claim):
        if variation.scenario is not None and (claim.factors is None or variation.factor in claim.factors):
            yield Change(variation.factor, variation.words, _value(variation, claim, store))


def variations(scenario: Scenario, model: HammersteinModel, claim: Claim) -> Iterator[Variation]:
    """Every factor that applies."""
    ideal = {"sensor": Instruments.ideal().sensor}
    instruments = scenario.instruments.model_copy(update=ideal)
    sensorless = scenario.model_copy(update={"instruments": instruments})
    yield Variation("sensor", "with an ideal sensor", sensorless, model)
    yield Variation("dynamics", "without dynamics", scenario, model.static())
    passes = with_passes(scenario, PASSES)
    yield Variation("passes", f"with {PASSES} passes a sample", passes, model)
    own = {
        **model.instruments.drive.model_dump(),
        **scenario.instruments.drive.model_dump(exclude_unset=True),
    }
    step = own["sample_time_s"] / FINER
    drive = Drive.model_validate(own | {"sample_time_s": step})
    finer = scenario.instruments.model_copy(update={"drive": drive})
    words = f"with a sample time of {1e6 * step:g} us"
    yield Variation("sample_time", words, scenario.model_copy(update={"instruments": finer}), model)
    volts = _amplitude_of_path(scenario, model, claim)
    if volts < model.amplitude_v:
        words = f"identified at {volts:.2g} V"
        smaller = _identified(scenario, "amplitude_v", volts)
        yield Variation("identification_amplitude", words, smaller, model)
    # a claim that compares frequencies, or follows one from where it was found, is not asked what they cost
    if claim.quantity.found_hz is None and len(set(_frequencies(scenario))) == 1:
        words = f"identified at {LOW_HZ:g} Hz"
        lower = _identified(scenario, "frequency_hz", LOW_HZ)
        yield Variation("identification_frequency", words, lower, model)


def rows_needed(
    scenario: Scenario,
    claims: Sequence[Claim],
    name: str,
    model: HammersteinModel,
    store: Store | None = None,
) -> list[Row]:
    """Rows that the claims select, from the cases alone that have them."""
    setup = set_up(scenario, name, model=model, fresh="" if store is None else store.fresh)
    cases = [
        case
        for case in setup.cases()
        if any(claim.selects(row) for row in empty_rows_of(setup, case) for claim in claims)
    ]
    kept = KeptCases(setup, store)
    return [row for result in kept.results(cases) for row in result.rows]


def _value(variation: Variation, claim: Claim, store: Store | None) -> float:
    assert variation.scenario is not None
    try:
        return claim.value(rows_needed(variation.scenario, [claim], claim.id, variation.model, store))
    except HammersteinError:
        return math.nan


def _of_claim(scenario: Scenario, claim: Claim) -> Scenario:
    """The scenario with the compensators or models alone that the claim names, each in its position."""
    named = {q.compensator for q in (claim.quantity, claim.over) if q is not None}
    if None in named:
        return scenario

    def kept(sources: Iterable[ModelSource]) -> tuple[ModelSource, ...]:
        return tuple(s if s.label in named else s.model_copy(update={"only_at_hz": ()}) for s in sources)

    return scenario.model_copy(
        update={"compensators": kept(scenario.compensators), "models": kept(scenario.models)}
    )


def _with_sources(scenario: Scenario, change: Callable[[Any], Any]) -> Scenario | None:
    """The scenario with every source changed; None where this changes nothing."""
    groups = {name: tuple(map(change, getattr(scenario, name))) for name in ("compensators", "models")}
    tested = (s for group in groups.values() for s in group if s.is_tested)
    before = (s for name in groups for s in getattr(scenario, name) if s.is_tested)
    return None if list(tested) == list(before) else scenario.model_copy(update=groups)


def adjusted(
    scenario: Scenario, model: HammersteinModel, claim: Claim, passes: int, at_path: bool
) -> Scenario:
    """The scenario with so many passes of the paper's law; models identified at the amplitude of a path."""
    told = with_passes(scenario, passes) or scenario
    if not at_path:
        return told
    return _identified(told, "amplitude_v", _amplitude_of_path(told, model, claim)) or told


def with_passes(scenario: Scenario, passes: int) -> Scenario | None:
    """The scenario with so many passes of the paper's law in a sample; None where it has no such law."""

    def change(source: ModelSource) -> ModelSource:
        is_paper = isinstance(source, InverseMultiplicative)
        return source.model_copy(update={"iterations": passes}) if is_paper else source

    return _with_sources(scenario, change)


def _identified(scenario: Scenario, key: str, value: float) -> Scenario | None:
    """The scenario with another amplitude or frequency of its closed-form identifications."""

    def change(source: ModelSource) -> ModelSource:
        spec = source.identification
        if not isinstance(spec, ClosedFormSpec):
            return source
        return source.model_copy(update={"identification": spec.model_copy(update={key: value})})

    return _with_sources(scenario, change)


def _frequencies(scenario: Scenario) -> Iterator[float]:
    """Frequency of every closed-form identification [Hz]."""
    for source in (*scenario.compensators, *scenario.models):
        if source.is_tested and isinstance(source.identification, ClosedFormSpec):
            yield source.identification.frequency_hz


def _amplitude_of_path(scenario: Scenario, model: HammersteinModel, claim: Claim) -> float:
    """Voltage [V] whose settled loops are as high as the path of the claim, on the axis that needs most."""
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
