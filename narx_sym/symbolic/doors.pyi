# What editors and mypy see of the doors; written by tests/stubs.py.
from narx_sym.engines.compile import compile as _engines_compile_compile
from narx_sym.engines.lambdify import lambdify as _engines_lambdify_lambdify
from narx_sym.symbolic.sensitivity import sensitivities as _symbolic_sensitivity_sensitivities

class RecursionDoors:
    compile = _engines_compile_compile
    sensitivities = _symbolic_sensitivity_sensitivities
    lambdify = _engines_lambdify_lambdify
