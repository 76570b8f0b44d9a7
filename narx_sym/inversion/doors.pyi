# What editors and mypy see of the doors; written by tests/stubs.py.
from narx_sym.codegen.targets import export_law as _codegen_targets_export_law
from narx_sym.codegen.units import coefficients as _codegen_units_coefficients
from narx_sym.engines.lambdify import lambdify as _engines_lambdify_lambdify
from narx_sym.fit.interop import law_rest_state as _fit_interop_law_rest_state
from narx_sym.fit.laws.backtracking import open_stages as _fit_laws_backtracking_open_stages
from narx_sym.fit.laws.counting import check as _fit_laws_counting_check
from narx_sym.fit.laws.damping import damping as _fit_laws_damping_damping
from narx_sym.fit.laws.damping import share_of as _fit_laws_damping_share_of
from narx_sym.fit.laws.internal import excursion as _fit_laws_internal_excursion
from narx_sym.fit.laws.internal import radius as _fit_laws_internal_radius
from narx_sym.fit.laws.internal import repelling as _fit_laws_internal_repelling
from narx_sym.fit.laws.run import exported as _fit_laws_run_exported
from narx_sym.fit.laws.run import follow as _fit_laws_run_follow
from narx_sym.fit.laws.run import run_law as _fit_laws_run_run_law
from narx_sym.fit.laws.stability import refuse_unstable as _fit_laws_stability_refuse_unstable
from narx_sym.fit.laws.stability import stability as _fit_laws_stability_stability
from narx_sym.fit.laws.stability import system_stability as _fit_laws_stability_system_stability
from narx_sym.fit.laws.start import law_start as _fit_laws_start_law_start
from narx_sym.fit.laws.start import rest_expression as _fit_laws_start_rest_expression
from narx_sym.fit.laws.start import rest_input as _fit_laws_start_rest_input
from narx_sym.fit.laws.trial import disturbance as _fit_laws_trial_disturbance
from narx_sym.fit.several import run_law as _fit_several_run_law
from narx_sym.report.notebook.shown import law_html as _report_notebook_shown_law_html
from narx_sym.tasks.commission import commission as _tasks_commission_commission

class CompensatorDoors:
    export = _codegen_targets_export_law
    coefficients = _codegen_units_coefficients
    lambdify = _engines_lambdify_lambdify
    run = _fit_laws_run_run_law
    exported = _fit_laws_run_exported
    follow = _fit_laws_run_follow
    commission = _tasks_commission_commission
    check = _fit_laws_counting_check
    open_stages = _fit_laws_backtracking_open_stages
    start = _fit_laws_start_law_start
    rest_input = _fit_laws_start_rest_input
    damping = _fit_laws_damping_damping
    disturbance = _fit_laws_trial_disturbance
    stability = _fit_laws_stability_stability
    refuse_unstable = _fit_laws_stability_refuse_unstable
    rest_expression = _fit_laws_start_rest_expression
    share = _fit_laws_damping_share_of
    rest_state = _fit_interop_law_rest_state
    _repr_html_ = _report_notebook_shown_law_html

class InternalDynamicsDoors:
    radius = _fit_laws_internal_radius
    repelling = _fit_laws_internal_repelling
    along = _fit_laws_internal_excursion

class SystemLawDoors:
    run = _fit_several_run_law
    stability = _fit_laws_stability_system_stability
    lambdify = _engines_lambdify_lambdify
