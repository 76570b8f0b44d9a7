"""What the export tests run: models, laws and recursions, each with a record and with what Python computes."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import sympy as sp
from paper import BENCH

import narx_sym as ns
from narx_sym.codegen.export import written
from narx_sym.engines.compile import compile
from narx_sym.fit.bases.play import Shape
from narx_sym.models.extend import extend, variants
from narx_sym.symbolic.recursion import Recursion
from narx_sym.symbolic.signals import k, phi1, phi2, signal, t, u, y

STILL = 12  # samples at rest before anything moves
# Names that a file may bring: words of the languages, their comments, and worse.
AWKWARD = (
    "int", "double", "main", "case", "past", "sin", "fabs", "EOF", "NULL", "__DATE__", "INFINITY", "linux", "k", "i",
    "t", "sample", "expected", "part_0", "u_past", "y_rest", "restart", "started", "END_VAR", "LREAL", "R", "Y",
    "a__b", "a_b", "_a", "a_", "2nd", "température", "°", "", " ", "a*/b", "/*", "*)", "(*", "//", "??/", "\\", '"',
    "a\nb", "#define u 0", 'x; system("touch pwned"); //', "*/ int main(void){} /*", "law_step", "z" * 300,
)  # fmt: skip


@dataclass(frozen=True)
class Subject:
    """A recursion with numbers, and how it is run."""

    recursion: Recursion
    values: dict
    thing: Any = None  # a model or a law
    rest: Any = None  # of the sequences by name; 0.3 for all others
    size: float = 1.0  # of what moves
    given: Any = None  # what moves instead of waves

    @cached_property
    def output(self):
        return {ns.Model: lambda: self.thing.output, ns.NARX: lambda: self.thing.output, ns.Compensator: lambda: ns.m}.get(
            type(self.thing), lambda: self.recursion.states[-1]
        )()  # fmt: skip

    def export(self, to, name, **options):
        return (
            self.thing.export(to, name, **options)
            if self.thing
            else written(to, self.recursion, self.values, name, **options)
        )

    def at_rest(self, name):
        return (self.rest or {}).get(name, 0.3)

    def waves(self, n):
        """Each input by name: at rest for a while, then a wave of its own; time goes on from the start."""
        if self.given:
            return {name: x[:n] for name, x in self.given.items()}
        i = np.maximum(np.arange(n) - STILL, 0)
        found = {}
        for j, base in enumerate(self.recursion.inputs):
            wave = np.sin(i / (17 + 3 * j)) + 0.5 * np.sin(i / (5.3 + j)) + 0.2 * np.sin(i / 411)
            found[str(base.label)] = self.at_rest(str(base.label)) + self.size * wave
        if t in self.recursion.inputs:
            found["t"] = np.arange(n) * 0.01
        return found

    def expected(self, n, of=None):
        """What the package's own doors compute; `of` names another state of a plain recursion."""
        waves, start = self.waves(n), self.at_rest(str(self.output.label))
        if isinstance(self.thing, ns.Model):
            own = str(self.thing.input.label)
            depth = max(1, self.recursion.depth)
            # What effects remember has its initial value, as in the source.
            held = {a: np.concatenate([np.full(depth, x[0]), x]) for a, x in waves.items()}
            held[own][:depth] = self.at_rest(own)
            return self.thing.simulate(held.pop(own), start, held or None)[depth:]
        if isinstance(self.thing, ns.Compensator):
            return self.thing.run(waves.pop("r"), start, waves or None)
        depth, lead = self.recursion.depth, self.recursion.lead
        padded = {a: np.concatenate([np.full(depth, x[0]), x, np.full(lead, x[-1])]) for a, x in waves.items()}
        theta = [float(self.values[p]) for p in self.recursion.parameters]
        initial = {b: self.at_rest(str(b.label)) for b in self.recursion.states}
        run = compile(self.recursion)(padded, theta, initial, length=n + depth + lead)
        return run[str((of or self.output).label)][depth : depth + n]

    def steps(self, n, sampled=False):
        """What each step takes, by name: the newest sample that the equations read, `sampled` none before time k."""
        depth, lead = self.recursion.depth, self.recursion.lead
        from narx_sym.symbolic.signals import lag, samples

        read = {s for _, right in self.recursion.updates for s in samples(right)}
        found = {}
        for name, x in self.waves(n).items():
            newest = min(lag(s) for s in read if str(s.base.label) == name)
            newest = min(newest, 0) if sampled else newest
            padded = np.concatenate([np.full(depth, x[0]), x, np.full(lead, x[-1])])
            found[name] = padded[depth - newest :][:n]
        return found


def valued(model, *effects, value=0.05, **shapes):
    """Put effects into a model, `id` or `id at place`, with numbers for their coefficients and shapes."""
    for wanted in effects:
        name, _, where = wanted.partition(" at ")
        channels = [name.partition(":")[2]] if ":" in name else []
        variant = next(v for v in variants(model, channels) if v.id == name and where in ("", v.where))
        added = extend(model, variant)
        numbers = dict(zip(model.symbols, model.theta, strict=True)) | dict.fromkeys(added.coefficients, value)
        numbers |= {s: shapes[str(s).partition("_")[0]] for s in added.shape}
        model = added.model.replace(theta=[numbers[s] for s in added.model.symbols])
    return model


def of(thing, **options):
    if isinstance(thing, ns.Compensator):
        return Subject(thing.exported(share=None), thing.model.values, thing, **options)
    return Subject(thing.recursion, thing.values, thing, **options)


def subjects():
    paper = BENCH.published(Ts=0.001)
    shifted = BENCH.published(operating_point={u: 1.8, y: -95.9})
    inverse = ns.NARX.from_terms(
        ["u[k-1]", "phi1[k-1]", "phi2[k-1]*phi1[k-1]*u[k-1]"], [1.0, 1.27, -0.02], input="y", output="u", lead=3
    )
    linear = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"], [1.2, -0.4, 0.15, 0.1], Ts=0.01)
    moved = ns.NARX.from_terms(
        ["y[k-1]", "phi1[k-1]", "u[k-1]"], [0.9, 0.7, 0.1], Ts=0.01, operating_point={u: 0.5, y: -2.0}
    )
    a, b, c, d = sp.symbols("a b c d", real=True)
    h = d * u[k - 1] - y[k - 1]
    bouc_wen = ns.Model(
        y[k - 1] + a * phi1[k] + b * abs(phi1[k]) * h + c * phi1[k] * abs(h), (a, b, c, d), [0.7, 0.008, 0.009, 1.6]
    )
    plays = Shape((0.3, 0.7), (0.2,), 1).model({u: 0.5}, [0.6, 1.0, 0.8, 0.4, 0.1, -0.2])
    p, q, v, w = (signal(name) for name in "pqvw")
    # Each side of the vertex, targets that are not reached, and a curve whose sign the reference turns.
    roots = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-1]**2", "y[k-1]*u[k-1]**2"], [0.6, 0.5, 0.15, 0.4])
    # A law by branches: which root is taken hangs on a sign, and one branch divides by what is zero in the other.
    branches = Recursion(
        (
            (v[k], ns.r[k + 1] - a * ns.r[k]),
            (w[k], sp.Piecewise((b / v[k] + v[k] * b / v[k] ** 2, abs(v[k]) > c), (0, True))),
            (q[k], sp.Piecewise((1, sp.Or(v[k] > c, sp.And(v[k] >= 0, w[k - 1] < 2))), (-1, True))),
            (
                ns.m[k],
                sp.Piecewise((ns.m[k - 1] / 2 + w[k], q[k] > 0), (ns.m[k - 1] / 3 - sp.Max(w[k], v[k], 0), True)),
            ),
        ),
        (a, b, c),
    )
    s = u[k] / 2
    functions = (
        sp.sin(s) + sp.cos(s) + sp.tan(s / 2) + sp.tanh(3 * s) + sp.sinh(s) - sp.cosh(s) + sp.exp(-s) + sp.log(s**2 + 1)
        + sp.atan(s) + sp.asin(s / 3) + sp.acos(s / 3) + sp.sqrt(s**2 + 2) + (s**2 + 1) ** sp.Rational(3, 7)
        + abs(s) ** 3 + sp.Heaviside(s) + sp.sign(s - 0.1) + sp.Max(s, y[k - 1], 0.1) + sp.Min(s, -y[k - 1])
        + 1 / (2 + sp.sin(s)) ** 3 + (s - 1) ** 20 / 1000 + sp.pi * s / sp.E + s / 3
    )  # fmt: skip
    return {
        "paper": of(paper, size=20.0, rest={"u": 1.0, "y": 2.0}),
        "shifted": of(shifted, rest={"u": 1.8, "y": -95.0}, size=2.0),
        "law": of(paper.compensator(), size=20.0, rest={"m": 1.0, "r": 2.0}),
        "shifted law": of(shifted.compensator(), rest={"m": 1.8, "r": -95.0}, size=2.0),
        "identified law": of(inverse.compensator()),
        "Bouc-Wen": of(bouc_wen, size=20.0),
        "Bouc-Wen with creep": of(valued(bouc_wen, "creep", tau=4.0), size=20.0),
        "backlash": of(valued(linear, "backlash at input", value=1.0, r=0.2)),
        "lag": of(valued(moved, "rate_dependence", value=1.0, tau=0.05), rest={"u": 0.6, "y": -1.9}),
        "hysteresis inside": of(valued(linear, "hysteresis at inside", b=0.7, g=0.4)),
        "effects": of(
            valued(
                moved, "backlash at output", "creep", "channel:temp at inside", "channel_gain:load", "ageing",
                value=0.02, r=0.2, tau=0.5,
            ),
            rest={"u": 0.6, "y": -1.9},
        ),
        "law beside a channel": of(valued(linear, "channel:temp at inside").compensator()),
        "play": Subject(
            Recursion(((p[k], sp.Max(u[k] - a, sp.Min(u[k] + a, p[k - 1]))), (y[k], p[k] + sp.tanh(u[k - 3]) / 3)), (a,)),
            {a: 0.3},
        ),
        "plays": of(plays),
        "law of plays": of(plays.compensator(), rest={"z1": -0.2, "z2": -0.2}),  # the plays rest at m - 0.5
        "law by roots": of(roots.compensator(), size=0.8),
        "branches": Subject(branches, {a: 0.98, b: 0.1, c: 0.05}),
        "functions": Subject(Recursion(((y[k], functions / 9),)), {}),
        "long delay": Subject(Recursion(((y[k], y[k - 1] / 2 + y[k - 40] / 4 + u[k - 3] - u[k - 100]),)), {}),
        "clock": Subject(Recursion(((y[k], y[k - 1] / 2 + sp.sin(k / 50) * u[k]),)), {}),
        "cubic": Subject(Recursion(((p[k], p[k - 1] ** 3 + u[k] / 5), (y[k], p[k] + y[k - 1] / 3 - y[k - 1] ** 2 / 9))), {}),
        "memoryless": Subject(Recursion(((y[k], 2 * u[k] + phi2[k] * phi1[k]),)), {}),
        "static": Subject(Recursion(((y[k], 2 * u[k] - abs(u[k])),)), {}),
        "silent": Subject(Recursion(((y[k], a * u[k] + b * p[k - 1] + y[k - 1] / 2),), (a, b)), {a: 0.0, b: 1.0}),
        "awkward": Subject(
            Recursion(
                (
                    *((signal(n)[k], signal(n)[k - 1] / 2 + u[k] / (i + 1)) for i, n in enumerate(AWKWARD[::4])),
                    (y[k], sum(signal(n)[k - i % 3] * (i + 1) / 900 for i, n in enumerate(AWKWARD))),
                )
            ),
            {},
        ),
    }  # fmt: skip


SUBJECTS = subjects()
