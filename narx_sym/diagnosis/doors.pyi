# What editors and mypy see of the doors; written by tests/stubs.py.
from narx_sym.report.comparison import plot_before_after as _report_comparison_plot_before_after
from narx_sym.report.comparison import plot_where_it_fails as _report_comparison_plot_where_it_fails
from narx_sym.report.notebook.live import live as _report_notebook_live_live
from narx_sym.report.notebook.shown import diagnosis_html as _report_notebook_shown_diagnosis_html
from narx_sym.report.page import write_report as _report_page_write_report
from narx_sym.report.plots.diagnosis import plot_candidates as _report_plots_diagnosis_plot_candidates
from narx_sym.report.plots.diagnosis import plot_ladder as _report_plots_diagnosis_plot_ladder

class DiagnosisDoors:
    report = _report_page_write_report
    plot_comparison = _report_comparison_plot_before_after
    plot_ladder = _report_plots_diagnosis_plot_ladder
    plot_candidates = _report_plots_diagnosis_plot_candidates
    plot_where_it_fails = _report_comparison_plot_where_it_fails
    live = _report_notebook_live_live
    _repr_html_ = _report_notebook_shown_diagnosis_html
