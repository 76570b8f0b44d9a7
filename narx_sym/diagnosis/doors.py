"""What users call on a diagnosis and what lives in later rooms."""

from ..symbolic.door import door


class DiagnosisDoors:
    """Each line is one function of the room that does it; it takes the diagnosis first."""

    report = door("report.page", "write_report")
    plot_comparison = door("report.comparison", "plot_before_after")
    plot_ladder = door("report.plots.diagnosis", "plot_ladder")
    plot_candidates = door("report.plots.diagnosis", "plot_candidates")
    plot_where_it_fails = door("report.comparison", "plot_where_it_fails")
    live = door("report.notebook.live", "live")
    _repr_html_ = door("report.notebook.shown", "diagnosis_html")
