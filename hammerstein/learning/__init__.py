"""Learning at the bench: the next drive for a periodic path, from what a sensor said of the last one."""

from hammerstein.learning.learned import Learned as Learned
from hammerstein.learning.lesson import Lesson as Lesson, lesson as lesson
from hammerstein.learning.simulated import (
    SimulatedTrial as SimulatedTrial,
    simulated_trials as simulated_trials,
)
from hammerstein.learning.unsure import Unsure as Unsure
