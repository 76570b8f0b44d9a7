"""What users call on a law and on its internal dynamics, and what lives in later rooms."""

from ..symbolic.door import door


class CompensatorDoors:
    """Each line is one function of the room that does it; it takes the law first."""

    export = door("codegen.targets", "export_law")
    to_c = door("codegen.targets", "law_to_c")
    to_st = door("codegen.targets", "law_to_st")
    to_fmu = door("codegen.targets", "law_to_fmu")
    to_js = door("codegen.targets", "law_to_js")
    to_casadi = door("codegen.targets", "law_to_casadi")
    run = door("fit.run_law", "run_law")
    follow = door("fit.run_law", "follow")
    check = door("fit.run_law", "check")
    start = door("fit.run_law", "law_start")
    rest_input = door("fit.run_law", "law_rest_input")
    rest_state = door("fit.interop", "law_rest_state")
    _repr_html_ = door("report.notebook", "law_html")


class InternalDynamicsDoors:
    """Each line is one function of the room that does it; it takes the internal dynamics first."""

    radius = door("fit.excursions", "radius")
    repelling = door("fit.excursions", "repelling")
    along = door("fit.excursions", "excursion")
