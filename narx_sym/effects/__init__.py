"""The catalogue of physical effects, one file per family; `effect` adds one of your own."""

from . import disturbance, dynamics, friction, memory, static
from ._effect import EFFECTS, Catalogue, Effect, Form, Scan, clip, effect, step

# A model of a static or linear base explains these by its own terms; a detector of their own looks at the samples.
DETECTED = ("sensor_saturation", "quantisation")

__all__ = [
    "DETECTED", "EFFECTS", "Catalogue", "Effect", "Form", "Scan", "clip", "disturbance", "dynamics", "effect",
    "friction", "memory", "static", "step",
]  # fmt: skip
