"""The catalogue of physical effects, one file per family.

`effect` adds one of your own from Python, `load_effects` from a file.
"""

from . import disturbance, dynamics, friction, memory, static
from ._effect import EFFECTS, Catalogue, Effect, Form, Scan, clip, effect, step
from ._text import load_effects, text_effect

# A model of a static or linear base explains these by its own terms; a detector of their own looks at the samples.
DETECTED = ("sensor_saturation", "quantisation")

__all__ = [
    "DETECTED",
    "EFFECTS",
    "Catalogue",
    "Effect",
    "Form",
    "Scan",
    "clip",
    "disturbance",
    "dynamics",
    "effect",
    "friction",
    "load_effects",
    "memory",
    "static",
    "step",
    "text_effect",
]
