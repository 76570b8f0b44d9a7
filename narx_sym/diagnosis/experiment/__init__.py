"""The next experiment: the input on which models that the present data cannot tell apart differ most."""

from .choose import check_limits, propose
from .proposal import Experiment, wider_file
from .signals import Limits, family

__all__ = ["Experiment", "Limits", "check_limits", "family", "propose", "wider_file"]
