"""Where the model fails: its error against everything that may matter, sorted by the share that each explains.

Two residuals are looked at: the free-run error, and the equivalent missing input, the smallest forcing that makes the
model follow the measurement (Hooker 2009). The dynamics smear the first; the second sits at the cause.
"""

from .find import Misfit, misfit_of, where_it_fails
from .forcing import missing_input
from .motion import reversals
from .panel import Panel
from .portrait import Portrait, portrait_of

__all__ = ["Misfit", "Panel", "Portrait", "misfit_of", "missing_input", "portrait_of", "reversals", "where_it_fails"]
