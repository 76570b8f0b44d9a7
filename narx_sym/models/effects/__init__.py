"""The catalogue of physical effects, one file per family.

`effect` adds one of your own from Python, `load_effects` from a file.
"""

from . import between, disturbance, dynamics, friction, memory, sensor, static
from ._effect import EFFECTS, MACHINES, PLACES, Catalogue, Effect, Form, Scan, clip, effect, step
from ._text import load_effects, text_effect

# No directions of the free run: they need a look at the samples themselves. There is no detector for them yet.
DETECTED = ("sensor_saturation", "quantisation")

__all__ = [
    "DETECTED", "EFFECTS", "MACHINES", "PLACES", "Catalogue", "Effect", "Form", "Scan", "between", "clip",
    "disturbance", "dynamics", "effect", "friction", "load_effects", "memory", "sensor", "static", "step",
    "text_effect",
]  # fmt: skip
