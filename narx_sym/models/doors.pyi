# What editors and mypy see of the doors; written by tests/stubs.py.
from typing import Any

from narx_sym.codegen.targets import export_model as _codegen_targets_export_model
from narx_sym.codegen.targets import export_system as _codegen_targets_export_system
from narx_sym.codegen.units import coefficient_units as _codegen_units_coefficient_units
from narx_sym.codegen.units import units_told as _codegen_units_units_told
from narx_sym.diagnosis.add import add as _diagnosis_add_add
from narx_sym.engines.columns import evaluate_quasi_static as _engines_columns_evaluate_quasi_static
from narx_sym.engines.lambdify import lambdify as _engines_lambdify_lambdify
from narx_sym.files.store import save as _files_store_save
from narx_sym.fit.continuous import continuous as _fit_continuous_continuous
from narx_sym.fit.interop import model_rest_state as _fit_interop_model_rest_state
from narx_sym.fit.interop import to_control as _fit_interop_to_control
from narx_sym.fit.interop import to_sysidentpy as _fit_interop_to_sysidentpy
from narx_sym.fit.least_squares import fit as _fit_least_squares_fit
from narx_sym.fit.several import evaluate_system as _fit_several_evaluate_system
from narx_sym.fit.several import free_run_system as _fit_several_free_run_system
from narx_sym.fit.several import simulate_system as _fit_several_simulate_system
from narx_sym.fit.simulate import predict as _fit_simulate_predict
from narx_sym.fit.simulate import simulate as _fit_simulate_simulate
from narx_sym.inversion.compensator import compensator as _inversion_compensator_compensator
from narx_sym.inversion.several import compensators as _inversion_several_compensators
from narx_sym.models.analysis import check as _models_analysis_check
from narx_sym.models.compose import feedback as _models_compose_feedback
from narx_sym.models.compose import parallel as _models_compose_parallel
from narx_sym.models.compose import series as _models_compose_series
from narx_sym.models.quasi_static import quasi_static as _models_quasi_static_quasi_static
from narx_sym.models.rewrite import smooth as _models_rewrite_smooth
from narx_sym.report.notebook.shown import model_html as _report_notebook_shown_model_html
from narx_sym.report.plots.run import plot_comparison as _report_plots_run_plot_comparison
from narx_sym.report.plots.sets import plot_quasi_static as _report_plots_sets_plot_quasi_static
from narx_sym.symbolic.sensitivity import sensitivities as _symbolic_sensitivity_sensitivities

class ModelDoors:
    @property
    def theta(self) -> Any: ...
    @property
    def sigma_y(self) -> Any: ...
    quasi_static = _models_quasi_static_quasi_static
    smooth = _models_rewrite_smooth
    check = _models_analysis_check
    save = _files_store_save
    sensitivities = _symbolic_sensitivity_sensitivities
    parallel = _models_compose_parallel
    __add__ = _models_compose_parallel
    feedback = _models_compose_feedback
    series = _models_compose_series
    __rshift__ = _models_compose_series
    lambdify = _engines_lambdify_lambdify
    compensator = _inversion_compensator_compensator
    coefficient_units = _codegen_units_coefficient_units
    units_told = _codegen_units_units_told
    export = _codegen_targets_export_model
    fit = _fit_least_squares_fit
    simulate = _fit_simulate_simulate
    predict = _fit_simulate_predict
    continuous = _fit_continuous_continuous
    to_control = _fit_interop_to_control
    to_sysidentpy = _fit_interop_to_sysidentpy
    rest_state = _fit_interop_model_rest_state
    add = _diagnosis_add_add
    plot_quasi_static = _report_plots_sets_plot_quasi_static
    plot_comparison = _report_plots_run_plot_comparison
    _repr_html_ = _report_notebook_shown_model_html

class SystemDoors:
    lambdify = _engines_lambdify_lambdify
    save = _files_store_save
    export = _codegen_targets_export_system
    sensitivities = _symbolic_sensitivity_sensitivities
    compensator = _inversion_several_compensators
    simulate = _fit_several_simulate_system
    free_run = _fit_several_free_run_system
    evaluate = _fit_several_evaluate_system

class EffectDoors:
    __rshift__ = _models_compose_series

class QuasiStaticDoors:
    evaluate = _engines_columns_evaluate_quasi_static
