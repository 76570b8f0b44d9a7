"""Pictures: time response and loop, quasi-static sets with their regions, where a model fails, what a diagnosis found.

Every function takes matplotlib axes or makes them, labels them with units, and returns the figure.
"""

from ..figures.describe import thin
from ..figures.still import BLACK, BLUE, GREEN, ORANGE, PINK, RED, SKY, YELLOW, label, new_axes
from .diagnosis import plot_candidates, plot_diagnosis, plot_ladder
from .failures import draw_panel, reach, where_it_fails
from .law import plot_internal
from .run import plot_commissioning, plot_comparison, plot_compensation, plot_reversal_curves, reversal_curves
from .sets import orientation, plot_quasi_static
from .valve import plot_valve

__all__ = [
    "BLACK", "BLUE", "GREEN", "ORANGE", "PINK", "RED", "SKY", "YELLOW", "draw_panel", "label", "new_axes",
    "orientation", "plot_candidates", "plot_commissioning", "plot_comparison", "plot_compensation", "plot_diagnosis",
    "plot_internal", "plot_ladder", "plot_quasi_static", "plot_reversal_curves", "plot_valve", "reach",
    "reversal_curves", "thin", "where_it_fails",
]  # fmt: skip
