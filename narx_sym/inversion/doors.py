"""What users call on a law and on its internal dynamics, and what lives in later rooms."""

from ..symbolic.door import door


class CompensatorDoors:
    """Each line is one function of the room that does it; it takes the law first."""

    export = door("codegen.targets", "export_law")
    coefficients = door("codegen.units", "coefficients")
    lambdify = door("engines.lambdify", "lambdify")
    run = door("fit.laws.run", "run_law")
    exported = door("fit.laws.run", "exported")
    follow = door("fit.laws.run", "follow")
    commission = door("tasks.commission", "commission")
    check = door("fit.laws.counting", "check")
    open_stages = door("fit.laws.backtracking", "open_stages")
    start = door("fit.laws.start", "law_start")
    rest_input = door("fit.laws.start", "rest_input")
    damping = door("fit.laws.damping", "damping")
    disturbance = door("fit.laws.trial", "disturbance")
    stability = door("fit.laws.stability", "stability")
    refuse_unstable = door("fit.laws.stability", "refuse_unstable")
    rest_expression = door("fit.laws.start", "rest_expression")
    share = door("fit.laws.damping", "share_of")
    rest_state = door("fit.interop", "law_rest_state")
    _repr_html_ = door("report.notebook.shown", "law_html")


class InternalDynamicsDoors:
    """Each line is one function of the room that does it; it takes the internal dynamics first."""

    radius = door("fit.laws.internal", "radius")
    repelling = door("fit.laws.internal", "repelling")
    along = door("fit.laws.internal", "excursion")


class SystemLawDoors:
    """Each line is one function of the room that does it; it takes the law first."""

    run = door("fit.several", "run_law")
    stability = door("fit.laws.stability", "system_stability")
    lambdify = door("engines.lambdify", "lambdify")
