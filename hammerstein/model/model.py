"""The Hammerstein model: hysteresis followed by linear dynamics, and its file."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, JsonValue

from hammerstein.arrays import Array, ByValue
from hammerstein.blocks.driving import DriveRange
from hammerstein.blocks.instruments import Instruments
from hammerstein.blocks.law import require_grid
from hammerstein.blocks.voltages import Verdict, Voltages
from hammerstein.dynamics import Dynamics, StaticDynamics, WithLoop
from hammerstein.dynamics.feedback_hysteresis import MatrixForm
from hammerstein.errors import InputError, Mistake, naming, refuse
from hammerstein.files import digest_of, read_limited, write_atomic
from hammerstein.hysteresis import HYSTERESIS, Hysteresis, HysteresisFile, Normals
from hammerstein.model.covariance import ParameterCovariance, ParameterCovarianceFile, drawn_blocks
from hammerstein.notebook_repr import NotebookRepr
from hammerstein.plugins import looked_up
from hammerstein.quantities import Name, Plain, Size, no_name, unique, word
from hammerstein.validation import WithInfinity, mistakes_in, suggestion

if TYPE_CHECKING:
    from hammerstein.blocks.block_system import BlockSystem
    from hammerstein.compensators.drive_file import Compensation, LawLike
    from hammerstein.model.simulation import Plant, Response, Wire

MOST_NAMED = 3
"""Most records in the origin of a model."""
NUMBERS = re.compile(r"\[\s+([-+0-9.eE,\s]+?)\s+\]")


@dataclass(frozen=True, eq=False)
class HammersteinModel(ByValue, NotebookRepr):
    """Actuator or model of an actuator: hysteresis, then linear dynamics.

        v = Gamma(u - u_0),    y = G v            (Hammerstein structure: paper, section 6)

    u is the absolute voltage. At the working point u_0 the plays are at rest and the position is 0.

    Parameters
    ----------
    name : name in reports
    hysteresis : m inputs, p outputs
    dynamics : p inputs, p outputs, unit gain at the frequencies at which the hysteresis was identified
    amplitude_v : largest voltage amplitude at which the hysteresis was identified [V]
    inputs, outputs : names of the axes; repeated names are numbered
    instruments : drive and sensor of the actuator; where they state no range of the drive, the default one
        gives way to voltages beyond it
    provenance : origin of the model, as plain JSON
    voltages : working point and range of the records; symmetric about 0 V, with that amplitude, if not given
    verdict : verdict of its identification, if it was identified from records
    covariance : of the parameters other than weights, and sensitivity of the weights to them
    """

    name: str
    hysteresis: Hysteresis[Any]
    dynamics: Dynamics
    amplitude_v: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    instruments: Instruments = field(default_factory=Instruments)
    provenance: JsonValue = None
    voltages: Voltages | None = None
    verdict: Verdict | None = None
    covariance: ParameterCovariance | None = None

    def __repr__(self) -> str:
        return (
            f"HammersteinModel({self.name!r}: {', '.join(self.inputs)} [V] to {', '.join(self.outputs)} "
            f"[um]; {self.hysteresis.describe()}; dynamics: {self.dynamics.describe()})"
        )

    def __post_init__(self) -> None:
        m, p = self.hysteresis.n_inputs, self.hysteresis.n_outputs
        for name in ("inputs", "outputs"):
            object.__setattr__(self, name, unique(getattr(self, name), word))
        mistakes = []
        rest = self.recorded.working_point_v
        if len(rest) != m:
            mistakes.append(Mistake("voltages", f"are for {len(rest)} inputs, not for {m}"))
        else:
            object.__setattr__(self, "hysteresis", self.hysteresis.counted_from(rest))
        if len(self.inputs) != m:
            mistakes.append(Mistake("inputs", f"names {len(self.inputs)} inputs of {m}"))
        if len(self.outputs) != p:
            mistakes.append(Mistake("outputs", f"names {len(self.outputs)} outputs of {p}"))
        free = self.dynamics if isinstance(self.dynamics, MatrixForm) else None
        if self.dynamics.n_outputs != p or (free and free.n_inputs != p):
            mistakes.append(
                Mistake("dynamics", f"must have {p} inputs and {p} outputs, as the hysteresis has")
            )
        for key, names in (("name", (self.name,)), ("inputs", self.inputs), ("outputs", self.outputs)):
            mistakes += [Mistake(key, why) for name in names if (why := no_name(name))]
            if len(set(names)) < len(names):
                mistakes.append(Mistake(key, "name two axes alike; every name must be different"))
        if self.covariance and (misfit := self.covariance.misfit(self.hysteresis, self.dynamics)):
            mistakes.append(Mistake("covariance", misfit))
        if free and (unstable := free.instability()):
            mistakes.append(Mistake("dynamics.A", unstable))
        refuse(f"model {self.name}", mistakes)
        if self.voltages:
            object.__setattr__(self, "instruments", self.instruments.reaching(self.voltages))

    @cached_property
    def recorded(self) -> Voltages:
        """Working point and range of the records; symmetric about 0 V if the file states none."""
        return self.voltages or Voltages.symmetric(self.amplitude_v, self.hysteresis.n_inputs)

    @property
    def origin(self) -> str:
        """Name of the model and the records that it was identified from.

        >>> HammersteinModel.load("duo_bimorph_static").origin
        'duo_bimorph_static'
        >>> replace(HammersteinModel.load("duo_bimorph_static"), provenance={"records": list("abcde")}).origin
        'duo_bimorph_static, from a, b, c and 2 more'
        """
        files = self.provenance.get("records") if isinstance(self.provenance, dict) else None
        if not isinstance(files, list):
            return self.name
        more = f" and {len(files) - MOST_NAMED} more" if len(files) > MOST_NAMED else ""
        return f"{self.name}, from {', '.join(map(str, files[:MOST_NAMED]))}{more}"

    def static(self) -> HammersteinModel:
        """Return the same static block without its dynamics."""
        return replace(self, dynamics=StaticDynamics(n_outputs=self.hysteresis.n_outputs), covariance=None)

    def drawn(self, generator: Normals) -> HammersteinModel:
        """Draw a random actuator from the covariance of all parameters.

        Raises InputError where they are not known.
        """
        hysteresis, dynamics = drawn_blocks(self.hysteresis, self.dynamics, self.covariance, generator)
        return replace(self, hysteresis=hysteresis, dynamics=dynamics, covariance=None)

    def simulate(
        self,
        u_v: ArrayLike,
        sample_time_s: float,
        *,
        instruments: Instruments | None = None,
        seed: int | Sequence[int] = 0,
        conditioned: bool = False,
        start_v: ArrayLike | None = None,
    ) -> Response:
        """Simulate the response to voltages from rest, with all signals.

        Parameters
        ----------
        u_v : (input, sample) absolute voltages [V]
        sample_time_s : time between samples [s], for which a voltage is held
        instruments : drive and sensor whose effects are wanted, such as the model's own; none if not given
        seed : of the sensor's noise
        conditioned : whether the actuator was driven to the highest, then to the lowest recorded voltage, and
            back to the start before; positions count from there
        start_v : (input,) voltage of the start [V]; the working point if not given

        Raises
        ------
        InputError : voltages for another number of inputs, or a sample time that does not fit the dynamics
        SimulationError : a voltage that is not finite

        Examples
        --------
        >>> model = HammersteinModel.load("duo_bimorph_static")
        >>> model.simulate([[0.0, 5.0], [0.0, 0.0]], 50e-6)
        Response(2 samples of 50 us, 2 inputs, 2 outputs; position 0 to 24.32 um)
        """
        u = np.atleast_2d(np.asarray(u_v, dtype=np.float64))
        if u.ndim != 2 or len(u) != self.hysteresis.n_inputs:
            raise InputError("voltage", f"has shape {u.shape}; give ({self.hysteresis.n_inputs}, samples)")
        plant, seeds = self._plant(sample_time_s, instruments), np.atleast_1d(seed).tolist()
        if not conditioned and start_v is None:
            return plant.respond(u, seeds)
        ends = np.stack([self.recorded.lowest_v, self.recorded.highest_v], axis=1)
        return plant.from_history(u, seeds, DriveRange.of(ends, self, start_v, conditioned))

    def compensate(
        self,
        reference_um: ArrayLike,
        *,
        law: LawLike = "hammerstein_inverse",
        range_v: ArrayLike | None = None,
        start_v: ArrayLike | None = None,
        conditioned: bool | None = None,
        clip: bool = False,
        beyond_records: bool = False,
        accept_flagged: bool = False,
        **options: Any,
    ) -> Compensation:
        """Voltages that follow a path, and the predicted motion.

        Parameters
        ----------
        reference_um : (output, sample) positions relative to the initial position [um], on the sample time of
            the model's drive
        law, options : a law and its options, by their names in a scenario; or a compensator
        range_v, start_v, conditioned, clip, beyond_records, accept_flagged : see ``Terms``

        Raises
        ------
        InputError : options that do not fit
        SimulationError : the law cannot work, the path is out of reach, or the drive leaves the records
        IdentificationError : the model's own fit report flagged it

        Examples
        --------
        >>> model = HammersteinModel.load("duo_bimorph_static")
        >>> found = model.compensate([[0.0, 10.0, 8.0], [0.0, 0.0, 5.0]], law="exact_inverse")
        >>> model.simulate(found.drive_v, 50e-6).position_um.round(2)  # on the steps of the converter
        array([[ 0., 10.,  8.],
               [ 0.,  0.,  5.]])
        """
        from hammerstein.compensators.drive_file import Terms, compensation_of

        low_high, start = (None if v is None else tuple(np.ravel(v).tolist()) for v in (range_v, start_v))
        terms = Terms(low_high, start, conditioned, clip, beyond_records, accept_flagged)
        return compensation_of(self, reference_um, law, options, terms)

    def _plant(self, sample_time_s: float, instruments: Instruments | None) -> Plant:
        """Return the model in a set-up on a sample grid."""
        from hammerstein.model.simulation import Plant

        require_grid(None, sample_time_s, "model")
        around = instruments or Instruments.ideal()
        drive = around.drive.model_copy(update={"sample_time_s": sample_time_s})
        return Plant(self, around.model_copy(update={"drive": drive}))

    def to_iosys(
        self,
        sample_time_s: float,
        *,
        instruments: Instruments | None = None,
        seed: int | Sequence[int] = 0,
        outputs: Sequence[Wire] = ("position_um",),
        name: str = "actuator",
    ) -> BlockSystem:
        """Return the whole actuator as a discrete ``control.NonlinearIOSystem``.

        Its inputs are ``requested_v[0]`` and so on, its outputs ``position_um[0]`` and so on: the names by
        which ``control.interconnect`` joins it to a compensator. It gives the numbers of
        ``hammerstein.simulate``.

        Parameters
        ----------
        sample_time_s : time between samples [s], for which a voltage is held
        instruments : drive and sensor whose effects are wanted, such as the model's own; none if not given
        seed : of the sensor's noise
        outputs : wires that leave the system: ``drive_v``, ``hysteresis_um``, ``position_um``, ``reading_um``
        name : of the system

        Raises
        ------
        InputError : a sample time that does not fit the dynamics, or an unknown wire
        """
        return self._plant(sample_time_s, instruments).to_iosys(seed, outputs, name)

    @property
    def about_middle(self) -> Hysteresis[Any]:
        """The hysteresis for voltages relative to the middle of the recorded range.

        Dead-zones, envelopes and planes depend on the absolute voltage: a loop about 0 V is another one.
        """
        ends = np.array([self.recorded.lowest_v, self.recorded.highest_v])
        return self.hysteresis.counted_from(ends.mean(axis=0)) if np.isfinite(ends).all() else self.hysteresis

    def amplitude(self, amplitude_v: ArrayLike) -> Array:
        """Half heights (output, input) [um] of the settled, slow loops at a voltage amplitude [V].

        The voltages are about the middle of the recorded range.

        Linear dynamics have unit gain at the frequency at which the static block was identified; a loop with
        hysteresis has a gain of its own.

        amplitude_v : of all inputs, or of each of them (m,)
        """
        static = self.about_middle.amplitude(amplitude_v)
        return self.dynamics.block().slow_ends(static) if isinstance(self.dynamics, WithLoop) else static

    def gain(self, amplitude_v: float) -> Array:
        """Gain matrix (output, input) [um/V] of the settled, slow loops at a voltage amplitude [V]."""
        return self.amplitude(amplitude_v) / amplitude_v

    def extremes(self, low_v: Array, high_v: Array) -> tuple[Array, Array]:
        """Lowest and highest position (p,) [um] from rest at slow voltages between two limits (m,) [V]."""
        if not isinstance(self.dynamics, WithLoop):
            return self.hysteresis.extremes(low_v, high_v)
        ends = np.stack([np.sign(end) * self.amplitude(np.abs(end)) for end in (low_v, high_v)])
        return ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)

    def on_grid(self, sample_time_s: float) -> HammersteinModel:
        """Return the model with its hysteresis on a sample grid, as rate-dependent hysteresis needs."""
        here = self.hysteresis.on_grid(sample_time_s)
        return self if here is self.hysteresis else replace(self, hysteresis=here)

    def static_response(self, drive_v: Array, start: Any = None) -> tuple[Array, Any]:
        """Outputs (output, sample) of the hysteresis [um] for absolute voltages, and its state.

        drive_v : (input, sample) [V]; start : state before; at rest at the working point if not given
        """
        rest = self.recorded.working_point_v
        return self.hysteresis.respond(drive_v - np.reshape(rest, (-1, 1)) if any(rest) else drive_v, start)

    def static_part(self, drive_v: Array, start: Any, first: int, stop: int, v_um: Array) -> Any:
        """Write such outputs into v_um (output, sample) for a range of samples; return the state after."""
        if not any(self.recorded.working_point_v):
            return self.hysteresis.carry_on(drive_v, start, first, stop, v_um)
        v_um[:, first:stop], after = self.static_response(drive_v[:, first:stop], start)
        return after

    @classmethod
    def load(cls, path: str | Path) -> HammersteinModel:
        """Read a model file, or a packaged actuator by its name.

        Raises InputError with every mistake in the file.
        """
        return cls.from_json(model_text(str(path)), str(path))

    @classmethod
    def from_json(cls, text: str, source: str = "model") -> HammersteinModel:
        """Model from the text of a model file; InputError with every mistake in it."""
        with naming(source), mistakes_in(source, ModelFile):
            return looked_up(lambda: ModelFile.model_validate_json(text)).model()

    def save(self, path: str | Path) -> None:
        """Write the model file, completely or not at all."""
        write_atomic(Path(path), self.to_json())

    def digest(self) -> str:
        """Short hash of everything in the model that affects numbers, independent of file layout."""
        return self._digest

    @cached_property
    def _digest(self) -> str:
        words = {"format", "name", "inputs", "outputs", "provenance", "verdict"}
        content = json.loads(ModelFile.of(self).model_dump_json(exclude=words, exclude_none=True))
        content["voltages"] = self.recorded.model_dump(
            exclude={"poling", "fastest_v_per_s"}  # the one follows from the others, and laws use neither
        )
        return digest_of(content)[:16]

    def to_json(self) -> str:
        """Text of the model file: full precision, sorted keys, a list of numbers in one line."""
        content = json.loads(ModelFile.of(self).model_dump_json(exclude_none=True))
        text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False)
        return NUMBERS.sub(lambda found: f"[{' '.join(found[1].split())}]", text) + "\n"


class ModelFile(WithInfinity):
    """Content of a model file: hysteresis, dynamics, voltages, names, verdict and provenance."""

    format: Literal["hammerstein-model/2"] = "hammerstein-model/2"
    name: Name
    hysteresis: Annotated[HysteresisFile, HYSTERESIS.field(), Field(description="chosen by its kind")]
    dynamics: Dynamics
    amplitude_v: Size
    inputs: tuple[Name, ...]
    outputs: tuple[Name, ...]
    instruments: Instruments = Instruments()
    voltages: Voltages | None = None
    verdict: Verdict | None = None
    covariance: ParameterCovarianceFile | None = None
    provenance: Plain = None

    def model(self) -> HammersteinModel:
        """Return the model this describes."""
        fields: dict[str, Any] = {n: getattr(self, n) for n in type(self).model_fields if n != "format"}
        known = None if self.covariance is None else self.covariance.value()
        return HammersteinModel(**fields | {"hysteresis": self._built(), "covariance": known})

    def _built(self) -> Hysteresis[Any]:
        """Return the hysteresis; the mistakes in it stand below its key."""
        try:
            return self.hysteresis.hysteresis()
        except InputError as error:
            named = [
                m._replace(where=".".join(filter(None, ("hysteresis", m.where)))) for m in error.mistakes
            ]
            raise InputError(error.source, named) from None

    @classmethod
    def of(cls, model: HammersteinModel) -> ModelFile:
        """Describe a model."""
        fields = {n: getattr(model, n) for n in cls.model_fields if n != "format"}
        return cls(**fields | {"hysteresis": model.hysteresis.file()})


HYSTERESIS.used_by(ModelFile)


def packaged_actuators() -> list[str]:
    """Names of the actuators that come with the package."""
    folder = resources.files("hammerstein.actuators")
    return sorted(f.name.removesuffix(".json") for f in folder.iterdir() if f.name.endswith(".json"))


LARGEST_MODEL_BYTES = 5_000_000
"""Largest model file; several axes with hundreds of operators need a tenth of it."""


TABLES = (".csv", ".txt", ".dat", ".npy", ".npz", ".mat", ".parquet", ".xlsx", ".tdms", ".h5", ".hdf5")
"""Suffixes of records and paths, which are no models."""


def model_text(name: str) -> str:
    """Text of the model file of a packaged actuator, or of a named file.

    Raises InputError for a name that is neither, and for a file that cannot be read or is too large.
    """
    place = place_of(name)
    if place.is_file() and place.suffix.lower() in TABLES:
        raise InputError(
            str(place),
            "is a table, but a model file (.json) was expected; first identify a model from records: "
            "hammerstein identify RECORD --out model.json",
        )
    return read_limited(place, "model file", LARGEST_MODEL_BYTES)


def place_of(name: str) -> Path:
    """Path of a packaged actuator, or of a named file.

    Raises InputError for a name that is neither.
    """
    names = packaged_actuators()
    if name in names:
        return Path(str(resources.files("hammerstein.actuators") / f"{name}.json"))
    if os.path.exists(Path(name)):  # no name is too long for it
        return Path(name)
    folder = Path(name).parent
    files = sorted(str(folder / file.name) for file in folder.glob("*.json"))
    if Path(name).suffix:
        raise InputError(name, f"cannot be read (no such file or directory){suggestion(name, files)}")
    meant = suggestion(f"{name}.json", files) or suggestion(name, names)
    raise InputError(name, f"is neither a model file nor a packaged actuator ({', '.join(names)}){meant}")
