"""What users call on a recursion and what lives in later rooms."""

from .door import door


class RecursionDoors:
    """Each line is one function of the room that does it; it takes the recursion first."""

    compile = door("engines.compile", "compile")
    sensitivities = door("symbolic.sensitivity", "sensitivities")
    lambdify = door("engines.lambdify", "lambdify")
