"""Learning at the set-up: the next drive for a periodic path, from what a sensor said of the last one."""

from hammerstein.compensators.learning.learned import Learned as Learned
from hammerstein.compensators.learning.lesson import Lesson as Lesson, lesson as lesson
from hammerstein.compensators.learning.unsure import Unsure as Unsure
