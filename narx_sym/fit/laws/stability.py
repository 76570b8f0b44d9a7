"""What is said first of a law: whether it forgets its own errors, and for which signals it was identified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import sympy as sp

from ...errors import ModelError, NarxError
from ...inversion.compensator import Compensator
from ...inversion.several import SystemLaw
from ...models.model import Model
from ...models.system import System
from ...symbolic.sensitivity import derivative
from ...symbolic.signals import k, samples, y
from ..simulate import rest_output
from .damping import damping
from .internal import DOUBLES, law_radius_at, operating_range
from .trial import TINY, Trial

LENGTH, PERIODS, INSIDE = 800, 2, 0.9  # samples of a trial, its periods, the part of the known range that it passes
ROUNDING = 1e-9  # of a pole on the unit circle
OTHER = 1e-3  # of the input's range: what is as far away is another input
_known: WeakKeyDictionary[Model, Stability] = WeakKeyDictionary()


@dataclass(frozen=True)
class Stability:
    """Whether a law is stable, and where its model is known.

    Attributes
    ----------
    stable : bool or None
        Whether a disturbance of the input stops growing; None where that is not known.
    why : str
        What was looked at.
    ranges : (name, lowest, highest) of input and output in the records; empty for a model that has seen none
    apart : float
        How far the input of a trial is from that which made its output, in ranges of the input: of the law as it is,
        without damping, which is late. 0 where none was run.
    """

    stable: bool | None
    why: str
    ranges: tuple[tuple[str, float, float], ...] = ()
    apart: float = 0.0

    def __str__(self) -> str:
        head = {True: "Stable", False: "UNSTABLE", None: "Stability not known"}[self.stable]
        known = " and ".join(f"{name} from {low:.4g} to {high:.4g}" for name, low, high in self.ranges)
        return f"{head}: {self.why}. Known range: {known or 'none, the model was not fitted to records'}."


def stability(law: Compensator) -> Stability:
    """Return whether a law is stable with its default damping, and for which range this is known."""
    found = _known.get(law.model)  # once: an equal model that is the key may be collected between two looks
    if found is None:
        known = law.model.info.ranges.items()
        ranges = tuple((name, float(low), float(high)) for name, (low, high) in known if name in ("u", "y"))
        stable, why, *apart = _judged(law)
        _known[law.model] = found = Stability(stable, why, ranges, *apart)
    return found


def system_stability(law: SystemLaw) -> Stability:
    """Return whether the law of a system is stable: by the poles of its own dynamics, at rest over the known range.

    Where the poles are not the same everywhere, the inputs rest at the ends and the middle of their known ranges.
    """
    system, known = law.system, law.system.ranges
    ranges = tuple((n, float(known[n][0]), float(known[n][1])) for n in (*system.inputs, *system.outputs) if n in known)
    if system.numbers is None:
        return Stability(None, "the parameters have no values", ranges)
    bases, depth = [left.base for left, _ in law.updates], law.recursion.depth
    rights = [right.xreplace(system.values) for _, right in law.updates]
    slopes = sp.Matrix([[derivative(e, b[k - i]) for i in range(1, depth + 1) for b in bases] for e in rights])
    points: list[dict[str, Any]] = [{}]
    if any(samples(e) for e in slopes):
        if not set(system.inputs) <= known.keys():
            return Stability(None, "the model has no known signal ranges to test it on", ranges)
        each = [(low, (low + high) / 2, high) for low, high in (known[n] for n in system.inputs)]
        points = [at for some in product(*each) for at in _at_rest(system, dict(zip(system.inputs, some, strict=True)))]
    sizes = []
    for at in points:
        top = np.array(slopes.xreplace({s: at[s.base.name] for e in slopes for s in samples(e)}), dtype=float)
        top = np.pad(top, ((0, 0), (0, len(bases) if not depth else 0)))
        companion = np.vstack([top, np.eye(top.shape[1])[: top.shape[1] - len(bases)]])
        sizes.append(float(np.abs(np.linalg.eigvals(companion)).max(initial=0.0)))
    if not sizes:
        return Stability(None, "the model rests nowhere in the known range", ranges)
    stable = True if max(sizes) <= 1 + ROUNDING else False if min(sizes) > 1 + ROUNDING else None
    between = f"from {min(sizes):.4g} " if stable is None else ""
    over = " at rest over the known range" if points[0] else ""
    return Stability(stable, f"its own dynamics have poles {between}up to {max(sizes):.4g}{over}", ranges)


def _at_rest(system: System, inputs: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return where a system rests with given inputs: values by the names of a law's signals; no complex ones."""
    given = {sp.Symbol(n, real=True): v for n, v in inputs.items()}
    held = [{str(s): sp.sympify(e).xreplace(given).evalf() for s, e in rest.items()} for rest in system.equilibria()]
    real = [{**inputs, **rest} for rest in held if all(e.is_Float for e in rest.values())]
    return [{f"{prefix}{n}": v for n, v in at.items() for prefix in ("", "m_", "r_")} for at in real]


def strays(law: Compensator) -> bool:
    """Whether on a slow sine through the known range a law takes other inputs than that which made the output.

    There are several then that stand apart, which algebra does not exclude: the model cannot tell them from each other,
    the machine can. On a flat piece all are alike.
    """
    return stability(law).apart > OTHER and not all(stage.alone for stage in (law.staged.stages if law.staged else ()))


def refuse_unstable(law: Compensator) -> None:
    """Raise ModelError for a law that is unstable."""
    found = stability(law)
    if found.stable is False:
        raise ModelError(f"The law is not exported. {found} To export it nevertheless, use force=True (--force).")


def _judged(law: Compensator) -> tuple[bool | None, str] | tuple[bool, str, float]:
    model = law.model
    if model.theta is None:
        return None, "the parameters have no values"
    damped = damping(law)
    if not law.staged and damped.share == 1:
        radius = law_radius_at(law)
        if radius is not None:  # the same wherever the law is
            return radius <= 1, f"its own dynamics have poles up to {radius:.4g}"
        passed = operating_range(law)
        if passed is not None and passed.largest <= 1:
            return True, f"its own dynamics have poles up to {passed.largest:.4g} over the known range"
        if passed is not None and min(passed.shares.values()) == 1:
            return False, f"its own dynamics repel in all of the known range, with poles up to {passed.largest:.4g}"
    if not {model.input.name, model.output.name} <= model.info.ranges.keys() or model.input == y:
        return None, "the model has no known signal ranges to test it on"
    return _tried(law, damped.share)


def _tried(law: Compensator, share: float) -> tuple[bool, str, float]:
    """Run a law over a slow sine through the known range, and disturb it once."""
    how = "on a slow sine through the known range" + (f", damped to {share:.3g} of each step," if share < 1 else "")
    try:
        late, most, apart = _grown(law, share)
    except NarxError:
        return False, f"{how} the law diverges", np.inf
    if not np.isfinite(most):
        return False, f"{how} the law diverges", np.inf
    if late >= DOUBLES:
        return False, f"{how} a disturbance of its input continues to grow, to {most:.3g} times its size", apart
    if most * TINY >= 1:  # larger than the range: it grows no more where it is as large as it can get
        return False, f"{how} a disturbance of its input grows to {most:.3g} times its size", apart
    if share == 1 and apart > OTHER and law.staged and all(stage.proved for stage in law.staged.stages):
        return False, f"{how} its input deviates from the only correct input by {apart:.3g} of its range", apart
    said = f"{how} a disturbance of its input grows to {max(1.0, most):.3g} times its size at most"
    return True, said, apart


def _grown(law: Compensator, share: float) -> tuple[float, float, float]:
    """Return by how much a disturbance grows from the middle of a trial to its end, and at most; and `apart`."""
    low, high = law.model.info.ranges[law.model.input.name]
    wave = np.sin(2 * np.pi * PERIODS * np.arange(LENGTH) / LENGTH)
    u, at = (low + high) / 2 + INSIDE * (high - low) / 2 * wave, LENGTH // 4
    trial, size = Trial.of_input(law, u, rest_output(law.model, u[0])), float(np.ptp(u))
    plain = trial.inputs(share=share)
    away = np.abs(trial.inputs(share=share, kick=TINY * size, at=at) - plain)[at:] / (TINY * size)
    away = np.nan_to_num(away, nan=np.inf, posinf=np.inf)
    middle, end = (float(part.max()) for part in np.array_split(away, 3)[1:])
    seen = LENGTH - law.preview  # later the reference is held
    gap = np.abs((plain if share == 1 else trial.inputs()) - u)[:seen]
    apart = float(np.nan_to_num(gap, nan=np.inf, posinf=np.inf).max()) / size
    return end / max(1.0, middle) if np.isfinite(end) else np.inf, float(away.max()), apart
