"""The structural assumptions of the paper as rules that exclude terms and explain themselves.

Each rule is one line of the paper; `violates` returns the reason why a term breaks it, or an empty text. Assumption
numbers are the paper's: 1 (label R2) for the continuum, A1 for the algebraic inversion, A2 for the identified inverse.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy as sp

from ..symbolic.printing import text
from ..symbolic.signals import Name, differences, expand_phi, held, lags, samples
from ..symbolic.signals import k as _k


@dataclass(frozen=True)
class Structure:
    """What the rules need to know beside the term: which sequences, and the pure delay tau_d."""

    output: sp.IndexedBase
    input: sp.IndexedBase
    delay: int

    def powers(self, term: Any) -> tuple[int, int, int, int]:
        """Return the total powers of (output, input, phi1, phi2) in a monomial, whatever the lags."""
        first, second = differences(self.input)
        totals = dict.fromkeys((self.output, self.input, first, second), 0)
        for factor in sp.Mul.make_args(term):
            base, exponent = factor.as_base_exp()
            for s in samples(base):
                if s.base in totals and exponent.is_Integer:
                    totals[s.base] += int(exponent)
        return tuple(totals.values())  # type: ignore[return-value]

    def rest_value(self, term: Any) -> Any:
        """Return the term at rest: y[k] = ybar, u[k] = ubar for all k."""
        ybar, ubar = (Name(n, real=True) for n in ("ybar", "ubar"))
        rest = {self.output: ybar, self.input: ubar}
        return held(expand_phi(term), lambda base: rest.get(base, Name(base.name, real=True)))


@dataclass(frozen=True)
class Rule:
    """One structural rule: its number, its statement, and the test of one term."""

    id: str
    statement: str
    violates: Callable[[Any, Structure], str]


@dataclass(frozen=True)
class Violation:
    """A term that breaks a rule; the term is None where the structure as a whole does."""

    rule: str
    term: Any
    reason: str

    def __str__(self) -> str:
        subject = "the model" if self.term is None else text(self.term)
        return f"{subject} violates {self.rule}: {self.reason}"


def _powers_of_output(term: Any, s: Structure) -> str:
    p_y, p_u, _, _ = s.powers(term)
    return f"the output enters with power {p_y} > 1" if p_y > 1 and p_u == 0 else ""


def _powers_of_sign(term: Any, s: Structure) -> str:
    second = differences(s.input)[1]
    factors = (f.as_base_exp() for f in sp.Mul.make_args(term))
    worst = max([0, *(power for base, power in factors if base in samples(term, second))])
    return f"phi2 enters with power {worst} > 1" if worst > 1 else ""


def _output_times_input(term: Any, s: Structure) -> str:
    p_y, p_u, p_1, p_2 = s.powers(term)
    mixed = p_y >= 1 and p_u >= 1 and p_1 == p_2 == 0
    return "output times input moves the equilibrium with the input" if mixed else ""


def _rest(term: Any, s: Structure) -> str:
    value = s.rest_value(term)
    if value == 0 or term in samples(term, s.output):
        return ""
    return f"at rest it is {value}, not 0: with Sigma_y = 1 the output would drift under a constant input"


def _newest_input(term: Any, s: Structure) -> str:
    newest = s.input[_k - s.delay]
    written = expand_phi(term)
    if not written.has(newest):
        return ""
    if written in samples(term) or term in samples(term, differences(s.input)[0]):
        return ""
    return f"it contains {text(newest)} other than linearly, which cannot be isolated"


def _one_linear_input(term: Any, s: Structure) -> str:
    if len(samples(term)) != 1 or sp.Mul.make_args(term)[0] != term or term.is_Pow:
        return ""
    first = differences(s.input)[0]
    sample = samples(term)[0]
    if term != sample or sample.base not in (s.input, first) or sample == first[_k - s.delay]:
        return ""
    kept = text(first[_k - s.delay])
    return f"of the linear input terms only {kept} is kept: ERR would not choose it among the others"


def _rate(term: Any, s: Structure) -> str:
    p_1 = s.powers(term)[2]
    if p_1 == 1 or term in samples(term, s.output):
        return ""
    return f"phi1 enters with power {p_1}, not 1: the loop would change with the speed of the input"


RULES: dict[str, Rule] = {
    rule.id: rule
    for rule in (
        Rule("1(i)", "no y^p, y^p phi1^m, y^p phi2^m with p > 1", _powers_of_output),
        Rule("1(ii)", "no phi2^m with m > 1", _powers_of_sign),
        Rule("1(iii)", "no y^p u^m", _output_times_input),
        # Assumption 1 does not ban these, but y[k] = y[k-1] + theta u[k-1] meets it with Sigma_y = 1 and drifts.
        Rule("rest", "terms other than y[k-i] vanish at rest", _rest),
        Rule("A1(i)", "the only regressor involving u[k-tau_d] is linear", _newest_input),
        # A loop that does not depend on the input's speed: the increment of y is of first degree in that of u (Visintin
        # 1994). All regressors of the paper's M are; a pool restricted to them extrapolates to other speeds.
        Rule("rate", "terms other than y[k-i] are of first degree in phi1", _rate),
        Rule("linear", "the linear input terms reduce to phi1[k-tau_d]", _one_linear_input),
    )
}
ASSUMPTION_1 = ("1(i)", "1(ii)", "1(iii)")
CONTINUUM = (*ASSUMPTION_1, "rest")
COMPENSATION = ("A1(i)", "linear")


def violations(terms: Iterable[Any], rules: Sequence[str], structure: Structure) -> list[Violation]:
    """Return each broken rule of each term."""
    return [
        Violation(name, term, reason)
        for term in terms
        for name in rules
        if (reason := RULES[name].violates(term, structure))
    ]


def structural(terms: Sequence[Any], structure: Structure) -> list[Violation]:
    """Check what the paper asks of the whole model: A1(ii) n_u > tau_d, A2(i) at least one regressor in the input."""
    found = []
    written = [expand_phi(t) for t in terms]
    used = sorted({i for t in written for i in lags(t, structure.input)})
    if not used:
        found.append(Violation("A2(i)", None, f"no regressor contains {structure.input.label!s}"))
    elif max(used) <= structure.delay:
        found.append(Violation("A1(ii)", None, f"n_u = {max(used)} is not larger than tau_d = {structure.delay}"))
    return found
