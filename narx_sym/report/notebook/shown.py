"""What a notebook shows of models, laws and diagnoses: MathML and tables, every name escaped."""

from __future__ import annotations

from html import escape
from typing import Any

from ...diagnosis.procedure import Diagnosis
from ...inversion.compensator import Compensator
from ...models.info import acts
from ...models.model import Model
from ...symbolic.mathml import from_latex, marked
from ...tasks.compensate import ahead
from ..figures.describe import stylesheet
from ..panels import candidates, ladder
from ..words import badge, headline, number, removed

LEFT = "text-align: left"


def table(columns: list[str], rows: list[list[Any]]) -> str:
    """Return an HTML table; every text is escaped."""
    head = "".join(f'<th style="{LEFT}">{escape(c)}</th>' for c in columns)
    body = "".join(f"<tr>{''.join(f'<td style={LEFT!r}>{escape(str(x))}</td>' for x in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def model_html(model: Model) -> str:
    """Return the equations of a model and its parameters."""
    digits = (("theta", 6), ("standard_error", 2))
    rows = [[r["symbol"], r["term"], *("" if r[n] is None else number(r[n], d) for n, d in digits)]
            for r in model.table()]  # fmt: skip
    shown = table(["parameter", "multiplies", "value", "standard error"], rows)
    point = ", ".join(f"{b.name} = {number(v, 4)}" for b, v in model.operating_point.items())
    around = f"<p>Around the operating point {escape(point)}.</p>" if point else ""
    return f"{marked(model)}<p>{acts(model.delay, model.Ts)}</p>{around}{shown}"


def law_html(law: Compensator) -> str:
    """Return the equations of a law, with symbols and with numbers."""
    numbers = from_latex(law.latex(numbers=True), 4) if law.model.values else ""
    return f"{from_latex(law.latex())}{numbers}<p>{ahead(law)}</p>"


def diagnosis_html(diagnosis: Diagnosis) -> str:
    """Return the verdict, the error ladder and the candidates."""
    rows = [
        [r["effect"], r["where"], *removed(r), r["parameters"]]
        for r in diagnosis.table()
    ]  # fmt: skip
    drawn = [ladder.picture(diagnosis, {}), *([candidates.picture(diagnosis)] if rows else [])]
    pictures = "".join(f'<div style="max-width: 30rem; flex: 1 1 20rem">{p.svg}</div>' for p in drawn)
    listed = table(["effect", "where", "share", "95 % interval", "parameters"], rows) if rows else ""
    style = stylesheet(".narx-sym") + ".narx-sym svg { width: 100%; height: auto; fill: currentColor }"
    return (
        f'<div class="narx-sym"><style>{style}</style><p><b>{escape(headline(diagnosis))}</b>'
        f" ({escape(badge(diagnosis))})</p><p>{escape(diagnosis.sentence())}</p>"
        f'<div style="display: flex; flex-wrap: wrap">{pictures}</div>{listed}</div>'
    )
