"""What users call on a model and what lives in later rooms, or stands on the model here."""

from ..symbolic.door import door, view


class ModelDoors:
    """Each line is one function of the room that does it; it takes the model first."""

    theta = view("engines.compile", "theta")
    sigma_y = view("models.rest_map", "sigma_y")
    quasi_static = door("models.quasi_static", "quasi_static")
    smooth = door("models.rewrite", "smooth")
    check = door("models.analysis", "check")
    save = door("files.store", "save")
    sensitivities = door("symbolic.sensitivity", "sensitivities")
    parallel = __add__ = door("models.compose", "parallel")
    feedback = door("models.compose", "feedback")
    series = __rshift__ = door("models.compose", "series")
    lambdify = door("engines.lambdify", "lambdify")
    compensator = door("inversion.compensator", "compensator")
    coefficient_units = door("codegen.units", "coefficient_units")
    units_told = door("codegen.units", "units_told")
    export = door("codegen.targets", "export_model")
    fit = door("fit.least_squares", "fit")
    simulate = door("fit.simulate", "simulate")
    predict = door("fit.simulate", "predict")
    continuous = door("fit.continuous", "continuous")
    to_control = door("fit.interop", "to_control")
    to_sysidentpy = door("fit.interop", "to_sysidentpy")
    rest_state = door("fit.interop", "model_rest_state")
    add = door("diagnosis.add", "add")
    plot_quasi_static = door("report.plots.sets", "plot_quasi_static")
    plot_comparison = door("report.plots.run", "plot_comparison")
    _repr_html_ = door("report.notebook.shown", "model_html")


class SystemDoors:
    """Each line is one function of the room that does it; it takes the system first."""

    lambdify = door("engines.lambdify", "lambdify")
    save = door("files.store", "save")
    export = door("codegen.targets", "export_system")
    sensitivities = door("symbolic.sensitivity", "sensitivities")
    compensator = door("inversion.several", "compensators")
    simulate = door("fit.several", "simulate_system")
    free_run = door("fit.several", "free_run_system")
    evaluate = door("fit.several", "evaluate_system")


class EffectDoors:
    """Each line is one function of the room that does it; it takes the effect first."""

    __rshift__ = door("models.compose", "series")


class QuasiStaticDoors:
    """Each line is one function of the room that does it; it takes the quasi-static sets first."""

    evaluate = door("engines.columns", "evaluate_quasi_static")
