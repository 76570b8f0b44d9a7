"""One step of a recursion as a CasADi `Function`."""

from __future__ import annotations

from typing import Any

from .registry import Request, export


@export("casadi", "CasADi")
def function(request: Request) -> Any:
    """Return f(state, inputs) -> (next, output): `narx_sym.codegen.export.written`."""
    from ..engines.casadi import transition  # CasADi takes long to load

    return transition(request.recursion, request.values, request.name, *(request.outputs or [request.returned]))
