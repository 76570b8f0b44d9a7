"""The next experiment: the input on which models that the present data cannot tell apart differ most."""

from .choose import propose
from .proposal import Experiment
from .signals import Limits, family

__all__ = ["Experiment", "Limits", "family", "propose"]
