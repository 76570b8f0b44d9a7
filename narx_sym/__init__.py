"""narx_sym: hysteretic actuators as symbolic NARX models, from measurements to a running compensator.

Read it in this order: `signals` (y[k] and the shift operator), `recursion` (the ordered list of update equations that
everything is), `model` (NARX and pools), `analysis` (section 3 of the paper), `invert` (section 4), `estimate`
(section 2). `compile` is the only bridge to numbers.

Then `effects` (what a model may lack) and `diagnosis` (which of it is missing).
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_WHERE = {
    "signals": ("breve_phi1", "breve_phi2", "k", "m", "phi1", "phi2", "r", "shift", "signal", "u", "y"),
    "errors": (
        "DataError",
        "Diverged",
        "FitError",
        "ModelError",
        "NarxError",
        "NotInvertible",
        "ParseError",
        "Unreachable",
    ),
    "parsing": ("parse",),
    "printing": ("latex", "text"),
    "markup": ("mathml",),
    "model": ("NARX", "Model", "Pool", "pool"),
    "analysis": ("check", "continuum", "jacobian", "property_1", "quasi_static", "sigma_y", "steady_state"),
    "invert": ("Compensator", "compensator"),
    "sensitivity": ("sensitivities",),
    "compile": ("to_casadi",),
    "export": ("to_c", "to_st"),
    "data": ("Record", "read"),
    "metrics": ("fit_percent", "mape", "nrmse", "nsavi", "rmse"),
    "interop": ("from_sysidentpy",),
    "simulation": ("evaluate", "free_run", "predict", "simulate"),
    "estimate": ("fit",),
    "bootstrap": ("Bootstrap", "block_bootstrap"),
    "selection": ("select",),
    "identification": ("identify", "identify_inverse"),
    "effects": ("EFFECTS", "Effect", "Form", "Scan", "effect", "load_effects"),
    "recursion": ("Recursion", "State"),
    "diagnosis": ("Candidate", "Diagnosis", "diagnose"),
    "experiment": ("Experiment",),
    "misfit": ("where_it_fails",),
    "store": ("load", "save"),
}
_HOME = {name: module for module, names in _WHERE.items() for name in names}
_MODULES = ("assumptions", "effects", "ensemble", "plants", "plots")
__all__ = sorted([*_HOME, *_MODULES])


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: `import narx_sym` itself stays cheap."""
    if name in _HOME:
        # No function here may have the name of a module: importing that module would hide it.
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    if name in _MODULES:
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
