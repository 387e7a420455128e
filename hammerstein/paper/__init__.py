"""The paper: its claims, their judgements, and the page of its figures.

A kind of assessment like those of others: nothing in the package imports this room, which the entry point
``paper`` of the group ``hammerstein.blocks`` names.
"""

from hammerstein.paper.assessment import Paper as Paper
