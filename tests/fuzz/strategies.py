"""Hypothesis strategies from the JSON schemas: files that are nearly right, and every way of being wrong."""

from __future__ import annotations

import json
import math
from copy import deepcopy
from typing import Any

from hypothesis import strategies as st

from hammerstein.model import HammersteinModel, ModelFile, packaged_actuators
from hammerstein.scenario import Scenario

Node = dict[str, Any]
DEEPEST = 6
HOSTILE = [math.inf, -math.inf, math.nan, 1e308, -1e308, 5e-324, -1.0, 0, 10**30, "", "x", "\x1b[31m", "../x",
           "n" * 3000, True, [], {}, [[1.0], [1.0, 2.0]], "=1+1", "<script>", "日本"]  # fmt: skip
USUAL = [0.5, 1.0, 2.0, 5.0, 8.0, 10.0, 50.0, 100.0, 0.05, 0.001, 50e-6]
WORDS = [*packaged_actuators(), "x", "y", "rms_um", "auto", "paper", "a b"]


def scenarios() -> st.SearchStrategy[Any]:
    """Content of scenario files: of anything that the schema knows, and of what is right but for a little."""
    return st.one_of(_of_the_schema(), altered(good_scenarios()), altered(good_scenarios()))


def _of_the_schema() -> st.SearchStrategy[Any]:
    return _from(Scenario.model_json_schema()).flatmap(
        lambda content: st.sampled_from([False, True, True, True]).map(
            lambda whole: _whole(content) if whole and isinstance(content, dict) else content
        )
    )


def _whole(content: dict[str, Any]) -> dict[str, Any]:
    """Mend what contradicts itself, so that what is wrong deeper down is reached."""
    in_volts = isinstance(content.get("drive"), dict) and len(content) % 2 == 0
    signal = content.get("drive" if in_volts else "reference")
    if not isinstance(signal, dict) or signal.get("kind") == "file":
        signal = {"kind": "sine", "frequency_hz": 50.0, "amplitude_v" if in_volts else "amplitude_um": 5.0}
    replaced = ("drive", "reference", "compensators", "models", "sweep", "assessment")
    kept = {name: value for name, value in content.items() if name not in replaced}
    kept["drive" if in_volts else "reference"] = signal
    if str(content.get("actuator")) not in packaged_actuators():
        kept["actuator"] = "duo_bimorph"
    table = "models" if in_volts else "compensators"
    sources = content.get(table)
    mended = []
    for i, source in enumerate(sources if isinstance(sources, list) else []):
        if isinstance(source, dict):
            one = {k: v for k, v in source.items() if k not in ("identification", "only_at_hz")}
            mended.append(one | {"label": f"s{i}", "model": "duo_bimorph"})
    law = {"label": "a", "law": "none", "model": "duo_bimorph"}
    kept[table] = mended or ([] if in_volts else [law])
    return kept


def models() -> st.SearchStrategy[Any]:
    """Content of model files, made in the same two ways."""
    right = altered(good_models())
    return st.one_of(_from(ModelFile.model_json_schema()), right, right, right)


def _from(schema: dict[str, Any]) -> st.SearchStrategy[Any]:
    @st.composite
    def draw(drawn: Any) -> Any:
        # Most files have a single hostile value, or none: two hide each other.
        hostility = drawn(st.sampled_from([0.0, 0.0, 0.02, 0.1]))
        chance = drawn(st.randoms(use_true_random=False))
        return _value(schema, schema.get("$defs", {}), chance, hostility, 0)

    return draw()


def _value(
    node: dict[str, Any], definitions: dict[str, Any], chance: Any, hostility: float, depth: int
) -> Any:
    if chance.random() < hostility:
        return deepcopy(chance.choice(HOSTILE))
    if "$ref" in node:
        return _value(definitions[node["$ref"].rpartition("/")[2]], definitions, chance, hostility, depth)
    alternatives = [*node.get("anyOf", ()), *node.get("oneOf", ())]
    if alternatives:
        return _value(chance.choice(alternatives), definitions, chance, hostility, depth)
    if "const" in node:
        return node["const"]
    if "enum" in node:
        return chance.choice(node["enum"])
    kind = node.get("type")
    if kind == "object" or "properties" in node:
        return _table(node, definitions, chance, hostility, depth)
    if kind == "array":
        least = node.get("minItems", 0)
        count = chance.choice([least, 1, 1, 2, 2, 3]) if depth < DEEPEST else least
        return [
            _value(node.get("items", {}), definitions, chance, hostility, depth + 1)
            for _ in range(max(count, least))
        ]
    if kind in ("number", "integer"):
        return _number(node, kind, chance)
    if kind == "boolean":
        return chance.random() < 0.5
    if kind == "null":
        return None
    return chance.choice(WORDS)


def _table(
    node: dict[str, Any], definitions: dict[str, Any], chance: Any, hostility: float, depth: int
) -> Any:
    required = set(node.get("required", ()))
    names = [n for n in node.get("properties", {}) if n in required or chance.random() < 0.3]
    if chance.random() < hostility:
        names = names[1:]
    table = {
        name: _value(node["properties"][name], definitions, chance, hostility, depth + 1) for name in names
    }
    if chance.random() < hostility:
        table[chance.choice(["phase_deg", "radus_um", "nmae", ""])] = 1.0
    return {name: value for name, value in table.items() if value is not None}


def _number(node: dict[str, Any], kind: str, chance: Any) -> Any:
    low, high = node.get("minimum", -1e9), node.get("maximum", 1e9)
    value = chance.choice([*USUAL, *USUAL, low, high, chance.uniform(0.0, 100.0)])
    value = min(max(value, low), high)
    return round(value) if kind == "integer" else float(value)


EDGES = [1e-9, 1e-6, 1e-3, 0.0, 0.5, 1.0, 3.0, 1e3, 1e4, 1e5, 1e6, 1e8, 1e9, 1e12, -1e-3, -1.0, -1e6, -1e9]


def altered(seeds: list[dict[str, Any]]) -> st.SearchStrategy[Any]:
    """Content that is right but for one to three of its values."""

    @st.composite
    def draw(drawn: Any) -> Any:
        chance = drawn(st.randoms(use_true_random=False))
        content = json.loads(json.dumps(chance.choice(seeds)))
        for _ in range(chance.choice([1, 1, 1, 2])):
            _alter(content, chance)
        return content

    return draw()


def _alter(content: Any, chance: Any) -> None:
    """Replace, remove or double one value somewhere."""
    table, key = _place(content, chance)
    old = table[key]
    choice = chance.random()
    if choice < 0.05 and isinstance(table, dict):
        del table[key]
    elif choice < 0.1 and isinstance(table, list):
        table.append(old)
    elif isinstance(old, int | float) and not isinstance(old, bool) and choice < 0.9:
        scaled = old * chance.choice([0.0, -1.0, 0.1, 0.5, 2.0, 10.0, 1000.0])
        value = chance.choice([chance.choice(EDGES), scaled])
        table[key] = round(value) if isinstance(old, int) and chance.random() < 0.9 else value
    else:
        table[key] = deepcopy(chance.choice(HOSTILE))


def _place(content: Any, chance: Any) -> tuple[Any, Any]:
    """A value somewhere, found from the top downwards: a long list weighs no more than a single key."""
    key = chance.choice(list(content) if isinstance(content, dict) else range(len(content)))
    inside = content[key]
    if isinstance(inside, dict | list) and inside and chance.random() < 0.97:
        return _place(inside, chance)
    return content, key


def good_scenarios() -> list[dict[str, Any]]:
    """Scenarios that run, with every law, every signal and every table."""
    sine = {"kind": "sine", "amplitude_um": 20.0, "frequency_hz": 50.0, "axis": "each", "offset_um": 0.0,
            "phase_deg": 0.0, "smooth_start_s": 0.0}  # fmt: skip
    source = {"model": "duo_bimorph"}
    laws = [
        {"law": "none", **source},
        {"law": "inverse_multiplicative", "iterations": 2, "filter_s": 1e-3, **source},
        {"law": "inverse_multiplicative", "gain": [[0.1, 0.0], [0.0, 0.1]], "run_anyway": True, **source},
        {"law": "decoupled_inverse", **source},
        {"law": "exact_inverse", "softening_v": 0.1, "run_anyway": True, **source},
        {"law": "hammerstein_inverse", "preview_s": 0.01, "filter_hz": 1000.0, "softening_v": 0.1, **source},
        {"law": "feedback", "proportional": [0.1, 0.1], "integral_per_s": [50.0, 50.0], **source},
        {"law": "exact_inverse", "identification": {"frequency_hz": 50.0, "amplitude_v": 9.0, "operators": 10,
         "settle_cycles": 3, "measured_cycles": 4, "sample_time_s": 5e-5}},
        {"law": "learned", "inverse": "hammerstein_inverse", "filter_hz": 1000.0, "weights": 0.05,
         "resonance": 0.01, "trial": 2, **source},
    ]  # fmt: skip
    drive = {"resolution_v": 3e-4, "range_v": 10.0, "sample_time_s": 5e-5}
    sensor = {"range_um": 250.0, "resolution_um": 0.04, "bandwidth_hz": 2000.0, "noise_um": 0.04}
    more = {
        "seed": 3,
        "measure": {"settle_cycles": 1, "settle_s": 0.01, "measured_cycles": 2},
        "instruments": {"drive": drive, "sensor": sensor},
        "tolerances": {"rms_um": {"relative": 0.1, "absolute": 1e-3}},
    }
    found = [
        {"question": "?", "actuator": "duo_bimorph", "reference": sine, **more,
         "compensators": [{"label": "a", **law}]}
        for law in laws
    ]  # fmt: skip
    shapes: list[dict[str, Any]] = [
        {"kind": "triangle", "amplitude": 5.0, "frequency_hz": 50.0, "axis": 1},
        {"kind": "circle", "radius": 5.0, "frequency_hz": 50.0, "phase_deg": 30.0},
        {"kind": "spiral", "radius": 5.0, "frequency_hz": 50.0, "trigger_s": 0.02, "decay_s": 0.01},
        {"kind": "lissajous", "amplitude": 5.0, "frequency_x_hz": 50.0, "frequency_y_hz": 75.0},
        {"kind": "multisine", "amplitude": 5.0, "lowest_hz": 20.0, "highest_hz": 400.0, "seed": 1},
        {"kind": "sine", "amplitude": 5.0, "frequency_hz": 50.0, "axis": "all", "offset": 1.0},
    ]
    for i, shape in enumerate(shapes):
        unit, table = ("v", "drive") if i % 2 else ("um", "reference")
        signal = {f"{k}_{unit}" if k in ("amplitude", "radius", "offset") else k: v for k, v in shape.items()}
        tested = {"label": "a", **source}
        sources = {"models": [tested]} if i % 2 else {"compensators": [tested | {"law": "none"}]}
        found.append({"question": "?", table: signal, **sources, **more})
    found.append({"question": "?", "reference": sine, "compensators": [{"label": "a", **laws[0]}],
                  "uncertainty": {"draws": 3, "seed": 1, "weights": 0.05, "resonance": 0.05, "damping": 0.1,
                                  "noise": 0.1}})  # fmt: skip
    found.append({"question": "?", "reference": sine, "sweep": {"frequency_hz": [40.0, 50.0]},
                  "compensators": [{"label": "a", **laws[0], "only_at_hz": [40.0]}],
                  "assessment": {"kind": "paper", "figure": "Fig. 1", "claims": [
                      {"id": "c", "statement": "s", "paper": 1.0, "quote": "q", "factor": 2.0, "quantity": {
                          "metric": "rms_um", "from_hz": 10.0, "to_hz": 60.0, "of": "spread"},
                          "agreement": {"within": 0.1, "at_most": 5.0}}]}})  # fmt: skip
    for actuator in ("asymmetric_stack", "rate_dependent_stack"):
        found.append({"question": "?", "actuator": actuator, "drive": {"kind": "sine", "amplitude_v": 5.0,
                      "frequency_hz": 50.0}, "models": [{"label": "a", "model": actuator}],
                      "measure": {"settle_cycles": 1, "settle_s": 0.0, "record_every": 3},
                      "tolerances": {"rms_um": {"relative": 0.1}}, "answered_by": "rms_um",
                      "yes_if": {"rms_um": 1.0}})  # fmt: skip
    found.append({"question": "?", "reference": sine, "compensators": [{"label": "a", **laws[4]}],
                  "study": {"how": "random", "samples": 3, "seed": 2, "values": {
                      "reference.amplitude_um": [5.0, 10.0], "instruments.sensor.noise_um": [0.0, 0.1],
                      "compensators[1].softening_v": [0.05, 0.2]}}})  # fmt: skip
    found.append({"question": "?", "reference": sine, "compensators": [{"label": "a", **laws[5]}],
                  "study": {"how": "zip", "values": {"seed": [1, 2], "measure.settle_cycles": [0, 1]}},
                  "sweep": {"combine": "zip", "frequency_hz": [40.0, 50.0],
                            "amplitude_um": [5.0, 8.0]}})  # fmt: skip
    return found


def good_models() -> list[dict[str, Any]]:
    """Model files of every kind of hysteresis and of dynamics."""
    found = [json.loads(HammersteinModel.load(name).to_json()) for name in packaged_actuators()]
    linear = json.loads(HammersteinModel.load("duo_bimorph_static").to_json())
    linear["dynamics"] = {"kind": "state_space", "A": [[0.5, 0.1], [0.0, 0.3]], "B": [[1.0, 0.0], [0.0, 1.0]],
                          "C": [[0.5, 0.0], [0.0, 0.7]], "D": [[0.0, 0.0], [0.0, 0.0]], "sample_time_s": 5e-5,
                          "input_delay_s": 1e-4}  # fmt: skip
    own = {"direct_um_per_v": 6.0, "hysteretic_um_per_v": 2.0, "beta_per_v": 0.3, "gamma_per_v": 0.1}
    cross = {"direct_um_per_v": 0.1, "hysteretic_um_per_v": -0.05, "beta_per_v": 0.2, "gamma_per_v": 0.0}
    block = {"kind": "bouc_wen", "pairs": [[own, cross], [cross, own]]}
    volts = {"working_point_v": [50.0, 0.0], "lowest_v": [0.0, -10.0], "highest_v": [100.0, 10.0],
             "poling": ["positive", "both"]}  # fmt: skip
    wen = found[0] | {"hysteresis": block, "amplitude_v": 50.0, "voltages": volts}
    beside = linear | {"hysteresis": {"kind": "parallel", "parts": [block, linear["hysteresis"]]}}
    return [*found, linear, wen, beside]
