"""Signals: references and drives as frozen values, and tables of them."""

from hammerstein.signals.shapes import (
    MOST_LINES as MOST_LINES,
    SIGNALS as SIGNALS,
    Circle as Circle,
    Degauss as Degauss,
    Excitation as Excitation,
    FromFile as FromFile,
    Lissajous as Lissajous,
    Multisine as Multisine,
    OnAxes as OnAxes,
    OneFrequency as OneFrequency,
    Reference as Reference,
    Shape as Shape,
    Sine as Sine,
    Spiral as Spiral,
    Triangle as Triangle,
    smooth_step as smooth_step,
    written as written,
)
