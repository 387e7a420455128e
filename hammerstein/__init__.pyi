from .blocks.instruments import Drive as Drive, Instruments as Instruments, Sensor as Sensor
from .blocks.law import Stream as Stream, stream as stream
from .blocks.limit_cycles import LimitCycle as LimitCycle, limit_cycles as limit_cycles
from .comparison.compare import compare as compare
from .comparison.result import Comparison as Comparison
from .compensators import (
    Compensator as Compensator,
    DecoupledInverse as DecoupledInverse,
    ExactInverse as ExactInverse,
    Feedback as Feedback,
    HammersteinInverse as HammersteinInverse,
    InverseMultiplicative as InverseMultiplicative,
    NoCompensation as NoCompensation,
)
from .dynamics import (
    AxesDynamics as AxesDynamics,
    Axis as Axis,
    CreepMode as CreepMode,
    ElastoSlip as ElastoSlip,
    ElectromechanicalDynamics as ElectromechanicalDynamics,
    FeedbackHysteresisDynamics as FeedbackHysteresisDynamics,
    LinearBlock as LinearBlock,
    StackAxis as StackAxis,
    StackMode as StackMode,
    StateSpaceDynamics as StateSpaceDynamics,
    StaticDynamics as StaticDynamics,
    cantilever as cantilever,
    discretise as discretise,
)
from .errors import (
    HammersteinError as HammersteinError,
    IdentificationError as IdentificationError,
    InputError as InputError,
    SimulationError as SimulationError,
    ToleranceError as ToleranceError,
)
from .experiment.report import Report as Report
from .experiment.run import run as run, simulate as simulate, simulate_in_blocks as simulate_in_blocks
from .hysteresis import (
    Asymmetric as Asymmetric,
    BoucWen as BoucWen,
    BoucWenPair as BoucWenPair,
    DeadZones as DeadZones,
    Envelope as Envelope,
    Generalised as Generalised,
    Hysteresis as Hysteresis,
    HysteresisFile as HysteresisFile,
    Pair as Pair,
    Parallel as Parallel,
    PlayState as PlayState,
    PrandtlIshlinskii as PrandtlIshlinskii,
    Preisach as Preisach,
    RateDependent as RateDependent,
    RatePlays as RatePlays,
    play as play,
)
from .identification.fit import Fit as Fit
from .identification.identify import identify as identify
from .identification.in_loop.identify import (
    LoopSettings as LoopSettings,
    identify_in_loop as identify_in_loop,
)
from .identification.linear.frequency_response import (
    FrequencyResponse as FrequencyResponse,
    frequency_response as frequency_response,
)
from .identification.linear.state_space import fit_state_space as fit_state_space
from .identification.settings import Settings as Settings
from .identification.static.closed_form import closed_form as closed_form
from .identification.static.static_block import fit_static as fit_static
from .model import HammersteinModel as HammersteinModel
from .model.simulation import Plant as Plant, Response as Response
from .plugins import register as register
from .records.loops import Loop as Loop, loop_table as loop_table
from .records.reading import (
    read_paired_records as read_paired_records,
    read_records as read_records,
    records_of_time_response as records_of_time_response,
)
from .records.record import Record as Record
from .regression.result import check as check
from .scenario import Scenario as Scenario, load_scenario as load_scenario
from .scenario.assessment import Assessment as Assessment, Judgement as Judgement
from .signals import (
    Circle as Circle,
    FromFile as FromFile,
    Lissajous as Lissajous,
    Multisine as Multisine,
    Sine as Sine,
    Spiral as Spiral,
    Triangle as Triangle,
)

__version__: str
