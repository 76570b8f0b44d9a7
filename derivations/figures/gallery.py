"""The page of the catalogue: each effect with its loop, its equation, its source, and what draws the same.

python derivations/figures/gallery.py page.md    # the book writes it when it is built
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym.engines.compile import compile
from narx_sym.models.effects import PLACES
from narx_sym.models.extend import Variant, extend, variants

Ts, PERIOD = 0.01, 400  # [s], samples of one period
MACHINE = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.2], Ts=Ts)  # follows its input within 0.05 s
LAGS = (1, 4, 16, 64, 256)  # [samples] of the first-order lags that stand for any linear model
START = 100  # [samples] after which nothing is left of how a run begins
ALIKE = 0.95  # share of the squared trace
SEEN = 0.005  # of the output's standard deviation: what is left beside a linear model
FAMILIES = {
    "static": "Static curves, springs and stops",
    "memory": "What remembers",
    "friction": "Friction and drag",
    "dynamics": "Dynamics",
    "disturbance": "Disturbances and further signals",
    "sensor": "The sensor",
}
# Coefficients and shape parameters of the pictures, where half of the range and a coefficient of 1 show little.
SHOWN: dict[str, dict[str, Any]] = {
    "dead_zone": {"r": 0.4},
    "saturation": {"r": 0.5},
    "asymmetric_gain": {"c": 0.4},
    "quadratic_gain": {"c": 0.4},
    "cubic_gain": {"c": 0.6},
    "hardening_spring": {"c": -0.25},
    "quadratic_spring": {"c": -0.04},
    "end_stop": {"c": 0.8, "r": 0.4},
    "sqrt_outflow": {"c": 0.15, "a": 1.1},
    "bilinear_gain": {"c": 0.1},
    "gravity": {"c": -0.2, "size": 3.0},
    "orifice": {"c": 0.03, "r": 0.01},
    "backlash": {"r": 0.3},
    "hysteresis": {"c": 0.6, "b": 3.0, "g": 0.3},
    "offset": {"c": 0.4},
    "drift": {"c": 0.06},
    "periodic_disturbance": {"c1": 0.08, "c2": 0.0, "f": 5.3},
    "channel": {"c": 0.5},
    "channel_gain": {"c": 0.5},
    "ageing": {"c": -0.06},
    "inertia": {"c": 0.12},
    "input_delay": {"d": 20},
    "rate_dependence": {"tau": 0.25},
    "rate_limit": {"r": 0.009},
    "uneven_speed": {"c": -0.93},
    "creep": {"c": 0.4, "tau": 0.3},
    "charge_curve": {"c1": 0.5, "c2": 0.3, "c3": 0.0},
    "coulomb_friction": {"c": 0.3, "where": "output"},
    "stiction": {"r": 0.02, "e": 0.05},
    "channel_friction": {"c1": 0.1, "c2": 0.3, "s": 0.002, "where": "output", "form": "smooth"},
    "stribeck_friction": {"c": 0.3, "s": 0.01, "where": "output"},
    "quadratic_drag": {"c": 1000.0, "where": "output"},
    "absolute_sensor": {},
    "output_limit": {"r": 0.5},
}


def sine(size: float = 1.0) -> Any:
    """Two slow periods."""
    return size * np.sin(2 * np.pi * np.arange(2 * PERIOD) / PERIOD)


def wander(size: float = 1.0) -> Any:
    """Random moves of many sizes, as slow as the sine."""
    return ns.plants.filtered_noise(N=4 * PERIOD, Ts=Ts, cutoff=0.5, peak=size, seed=1)


def beside(n: int) -> Any:
    """The further signal that effects of a channel are driven by: slow, from 0 to 1."""
    return 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / (2.3 * PERIOD))


@cache
def placed(variant: Variant) -> tuple[Any, Any]:
    """The machine with an effect, and its compiled recursion."""
    model = extend(MACHINE, variant).model
    return model, compile(model.recursion, "python")


def run(variant: Variant | None, u: Any, values: dict[str, float]) -> Any:
    """The machine's answer from rest with an effect whose parameters are given by the effect's own names."""
    model, compiled = placed(variant) if variant else (MACHINE, compile(MACHINE.recursion, "python"))
    known = dict(zip(map(str, MACHINE.symbols), MACHINE.theta, strict=True))
    if variant:
        known |= {str(symbol): values[name] for name, symbol in model.effects[0].symbols.items()}
    before = model.recursion.depth
    given = {"u": u, "temp": beside(u.size), "t": np.arange(u.size) * Ts}
    given = {b.name: np.concatenate([np.zeros(before), given[b.name]]) for b in model.recursion.inputs}
    rest = {b.name: 0.0 for b in model.recursion.states}
    found = compiled(given, [known[str(s)] for s in model.symbols], rest, output=model.output)
    return found["y"][before:]


def pictured(name: str) -> Variant:
    """The form and place of an effect that is drawn: the first ones, unless `SHOWN` says where."""
    given = SHOWN.get(name, {})
    (form,) = (f for f in ns.EFFECTS[name] if f.form == given.get("form", ns.EFFECTS[name][0].form))
    usual = [v for v in variants(MACHINE, ["temp"]) if v.effect is form and v.where == given.get("where", v.where)]
    nearest = min(usual, key=lambda v: sum(abs(n - given.get(p, 0)) for p, n in v.fixed))
    return replace(nearest, fixed=tuple((p, given.get(p, n)) for p, n in nearest.fixed))


def shown(name: str, u: Any) -> Any:
    """The answer with an effect, as it is drawn."""
    variant = pictured(name)
    given = {"c": 1.0} | {p: 0.5 for p in variant.effect.shape} | SHOWN.get(name, {})
    return run(variant, u, given)


def grid(variant: Variant, u: Any) -> Iterator[dict[str, float]]:
    """Shape parameters that the search would begin from, roughly."""
    units = {"amplitude": np.abs(u).max(), "speed": np.sqrt(np.mean(np.diff(u) ** 2)), "gain": 1.0, "ratio": 1.0}

    def of(scan: Any) -> list[float]:
        if scan.of == "time":
            return [3 * Ts * (u.size / 12) ** v for v in scan.values]
        if scan.of == "peaks":
            return [5.3]
        if scan.of == "stroke":
            return [v * PERIOD * Ts / np.pi for v in scan.values]
        return [v * float(units.get(scan.of, 1.0)) ** scan.power for v in scan.values]

    names = variant.shape
    for values in product(*(of(variant.effect.scan[p]) for p in names)):
        yield dict(zip(names, values, strict=True))


def free_of(columns: Any) -> Any:
    """A function that takes off what lies in the span of the columns, once the start is forgotten."""
    Q = np.linalg.qr(columns[START:])[0]
    return lambda x: x[START:] - Q @ (Q.T @ x[START:])


def linear(u: Any) -> Any:
    """What a linear model may do: a constant, the input, and lags of it."""
    columns = [np.ones(u.size), u, np.gradient(u)]
    for n in LAGS:
        w, lagged = float(u[0]), []
        for x in u:
            w += (x - w) / (1 + n)
            lagged.append(w)
        columns.append(np.array(lagged))
    return free_of(np.column_stack(columns))


@cache
def traces(kind: Callable[[float], Any], size: float) -> dict[str, list[Any]]:
    """Of each effect, by id, what its forms do to the output in all places: a sign, and columns, for each shape."""
    u = kind(size)
    off, plain, found = linear(u), run(None, u, {}), {}
    for variant in variants(MACHINE, ["temp"]):
        one = variant.effect
        if one.weights or one.only or variant.channel:  # five plays draw nearly everything, and are priced so
            continue
        names = list(placed(variant)[0].effects[0].coefficients)
        for shape in grid(variant, u):
            strength = 1.0 if one.full else 0.02 / size**2
            try:
                columns = [run(variant, u, shape | {n: strength * (n == c) for n in names}) - plain for c in names]
            except ns.Diverged:  # a hysteresis that stiffens without bound runs away
                continue
            found.setdefault(one.id, []).append((one.sign, np.column_stack([off(column) for column in columns])))
    return found


def explained(trace: Any, sign: int, columns: Any) -> float:
    """The share of a squared trace that lies in the span of the columns, where the effect may have that sign."""
    if sign and sign * float(columns[:, 0] @ trace) < 0:
        return 0.0
    U, s, _ = np.linalg.svd(columns, full_matrices=False)
    U = U[:, s > 1e-9 * max(s[0], 1e-30)] if s.size and s[0] > 1e-12 else U[:, :0]
    return float(np.sum((U.T @ trace) ** 2) / max(np.sum(trace**2), 1e-30))


def alike(name: str, kind: Callable[[float], Any]) -> dict[str, float] | None:
    """Other effects that draw the same as the picture, with their share; None where a linear model does."""
    size = SHOWN.get(name, {}).get("size", 1.0)
    u = kind(size)
    plain = run(None, u, {})
    trace = linear(u)(shown(name, u) - plain)
    if np.sqrt(np.mean(trace**2)) < SEEN * np.std(plain):
        return None
    all_ = traces(kind, size).items()
    shares = {other: max(explained(trace, *one) for one in many) for other, many in all_ if other != name}
    return dict(sorted(shares.items(), key=lambda pair: -pair[1]))


def svg(name: str) -> str:
    """The loop of an effect, beside that of the machine without it, in the colours of the page."""
    u = sine(SHOWN.get(name, {}).get("size", 1.0))
    with_it, without = shown(name, u), run(None, u, {})
    later = slice(None) if pictured(name).driver == "t" else slice(PERIOD, None)  # time goes on; a loop closes
    wide, high, edge = 240, 180, 10
    y = np.concatenate([with_it[later], without[later]])
    middle, half = (y.max() + y.min()) / 2, (y.max() - y.min()) / 2

    def path(run: Any) -> str:
        across = wide / 2 + u[later][::4] / u.max() * (wide / 2 - edge)
        up = high / 2 - (run[later][::4] - middle) / half * (high / 2 - edge)
        return "M" + " ".join(f"{a:.1f} {b:.1f}" for a, b in zip(across, up, strict=True))

    return (
        f'<svg viewBox="0 0 {wide} {high}" role="img" aria-label="Output over input with {name}, and without">'
        f'<path class="without" d="{path(without)}"/><path class="with" d="{path(with_it)}"/></svg>'
    )


def equation(name: str) -> str:
    """The equations of the usual form, as LaTeX."""
    variant = pictured(name)
    one = variant.effect
    positive = {p: sp.Symbol(p, positive=True) for p in variant.shape}
    form = one.equations(Ts=sp.Symbol("T_s", positive=True), **positive, **dict(variant.fixed))
    many = len(form.z) > 1
    added = [sp.Mul(sp.Symbol(f"c_{i + 1}" if many else "c"), z) for i, z in enumerate(form.z)]
    lines = [" + ".join(ns.latex(z) for z in added).replace("+ -", "- ")]
    lines += [f"{ns.latex(state.left)} = {ns.latex(state.right)}" for state in form.states]
    return "\n".join(f"$$\n{line}\n$$\n" for line in lines)


def said(shares: dict[str, float] | None) -> str:
    """What draws the same, in words."""
    if shares is None:
        return "a linear model"
    told = {other: f"[](#{other}) {int(100 * share)} %" for other, share in shares.items()}
    return (
        ", ".join(told[o] for o in told if shares[o] >= ALIKE) or f"nothing else; nearest {next(iter(told.values()))}"
    )


def entry(name: str) -> str:
    """One effect: picture, equations, and what is known of it."""
    forms = ns.EFFECTS[name]
    one, variant = pictured(name).effect, pictured(name)
    rows = [f"{form.form or 'the usual one'} ({form.source})" for form in forms if form is not one]
    own = " of a further signal" if "channel" in one.arguments else ""
    text = [
        f"({name})=\n### `{name}`\n",
        f"{one.sentence}\n",
        "::::{container} effect\n",
        f"```{{raw}} html\n{svg(name)}\n```\n",
        ":::{container} equations\n",
        f"It adds, {PLACES[variant.where]}{own}:\n",
        equation(name),
        ":::\n::::\n",
        f"- acts {one.acts}",
        f"- source: {one.source}",
    ]
    if len(forms) > 1:
        text.append(f"- further forms: {'; '.join(rows)}")
    if one.only or one.never:
        text.append(f"- {'tried only for' if one.only else 'impossible in'}: {', '.join(one.only or one.never)}")
    if "channel" in one.arguments:
        text.append("- drawn the same by: whatever the further signal resembles")
    else:
        text.append(f"- drawn the same on one sine by: {said(alike(name, sine))}")
        text.append(f"- drawn the same on random moves by: {said(alike(name, wander))}")
    return "\n".join(text) + "\n"


HEAD = f"""# The effects, with their loops

The catalogue of `diagnose`: {len(ns.EFFECTS)} effects in {sum(map(len, ns.EFFECTS.values()))} forms. This page is
written from the catalogue itself when the book is built (`derivations/figures/gallery.py`).

Each picture shows the output over the input of a slow sine (4 s). The dashed line is a machine that follows its input
within 0.05 s; the solid line is the same machine with the effect. The equation is what the effect adds; $c$ is its
coefficient, $x$ is what drives it, and at $c = 0$ the machine is as before. `narx-sym effects` lists all forms.

**Drawn the same** says with what an effect is confused. Both effects act on that machine; what a linear model
can follow is taken off (a constant, the input, its derivative, five lags); then the other effect explains this share of
the squared rest, in its best form, place and shape of the search grid, with a sign that it may have. Shares from {100 * ALIKE:.0f} % on are listed. The strength is that of
the picture: a weaker effect looks more like others. An input that moves at random separates more effects than a
sine does. Under a triangle of one speed a slack, dry friction and a hysteresis are even
linear ([](../../results/limits.md)). How often the right name comes first is measured in [](../../results/named.md).
"""


def page() -> str:
    """The page."""
    parts = [HEAD]
    for family, title in FAMILIES.items():
        names = [name for name, forms in ns.EFFECTS.items() if forms[0].family == family]
        parts += [f"## {title}\n", *map(entry, names)]
    return "\n".join(parts)


def write(app: Any = None) -> None:
    """Write the page where the book reads it."""
    target = Path(app.srcdir) / "reference" / "generated" / "effects.md" if app else Path(sys.argv[1])
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    write()
