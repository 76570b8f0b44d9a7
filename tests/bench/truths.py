"""Simulated truths for the honest evaluation: actuators with a hidden physical effect, and actuators without one.

Independent of the package on purpose: only numpy and scipy are imported, so a wrong formula there cannot also be wrong here.

The plant is ``tau y' + y = K w`` or ``y''/wn^2 + 2 zeta y'/wn + y = K w`` with ``w = u``, at rest at zero when a record begins.
It is solved on a grid ``FINER`` = 20 times finer than the sampling. The linear part is exact (matrix exponential); an
internal effect enters as a force ``f``, so that ``K w - f`` drives the plant. The input is either a held command (zero-order
hold, recorded right after each update) or, for half of the seeds of smooth excitations, an analogue signal that moves between
the samples. Time constants are fixed in seconds (8 to 20 samples at ``Ts`` = 0.01), so a smaller ``Ts`` samples faster.

*Size* of an effect is the standard deviation of what it adds to the clean output, relative to that of the linear actuator's
output. It is log-uniform in 3 to 15 % (pairs: 5 to 12 %, each effect alone). A refitted linear base absorbs a part;
``info["left"]`` tells roughly how much survives that.

The catalogue's ``input_delay``, ``rate_dependence`` and ``inertia`` are no truths here: a linear base of higher order or with
a delay absorbs them. ``offset`` is part of the plant, with or without an effect.

Every draw comes from a generator seeded by the seed, a CRC-32 of group and kind, and the purpose of the draw. Therefore noise,
level and excitation can change while the plant and the effect's shape stay.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

Array = np.ndarray

DEV = range(100, 103)  # seeds for development
JUDGE = range(1000, 1015)  # seeds for judging; never look at them before the thresholds are frozen
FINER = 20  # steps of the solver per sample
SIZE = (0.03, 0.15)  # size of a single effect
SIZE_PAIR = (0.05, 0.12)  # size of each effect of a pair
TOLERANCE = 0.02  # relative accuracy of the size
EXCITATIONS = ("random", "sine", "steps")
NOISES = ("white", "ar95", "ar80", "band", "drifting")

IN = {
    "backlash": "play at the input (Krasnosel'skii and Pokrovskii 1989)",
    "coulomb_friction": "dry friction with true sticking in a mass-spring-damper (Coulomb 1785)",
    "stribeck_friction": "dry friction that falls with speed, with true sticking (Stribeck 1902; Armstrong-Helouvry 1991)",
    "quadratic_drag": "force v|v| (Newton 1687; Morison 1950)",
    "hardening_spring": "restoring force y^3 (Duffing 1918)",
    "quadratic_spring": "restoring force y^2 (Helmholtz 1863)",
    "bilinear_gain": "gain that depends on the position: u y (Mohler 1973)",
    "dead_zone": "dead zone at the input (Tao and Kokotovic 1994)",
    "saturation": "hard clip or tanh at the input, by seed",
    "asymmetric_gain": "another gain for negative inputs: |u|",
    "quadratic_gain": "u^2 at the input (Hammerstein 1930)",
    "cubic_gain": "u^3 at the input, growing gain (Hammerstein 1930)",
    "hysteresis": "Bouc-Wen memory (Bouc 1967; Wen 1976) at the output, at the input or as internal force, by seed",
    "creep": "three slow lags of the input, tau, 3 tau, 9 tau, added to the output (Kuhnen and Janocha 1998)",
    "drift": "ramp in time",
    "periodic_disturbance": "one sinusoid that has nothing to do with the input",
    "channel:temperature": "offset proportional to a measured slow channel",
    "channel_gain:temperature": "gain proportional to a measured slow channel",
    "ageing": "gain that changes linearly in time",
}
OFF = {
    "lugre_friction": "bristle friction in a mass-spring-damper (Canudas de Wit, Olsson, Astrom, Lischinsky 1995)",
    "tanh_friction": "smooth dry friction Fc tanh(v/vs) (Andersson, Soderberg, Bjorklund 2007)",
    "maxwell_slip": "6 to 10 elastic sliders in parallel at the output (Iwan 1966; Lampaert, Al-Bender, Swevers 2003)",
    "jiles_atherton": "ferromagnetic hysteresis at the input (Jiles and Atherton 1986)",
    "atan_saturation": "arctangent at the input",
    "log_creep": "power-law relaxation by many time constants at the output (Findley 1944; Vieira 1986)",
    "soft_dead_zone": "dead zone with softplus corners at the input",
    "elastic_backlash": "gap with spring and damper in contact (Nordin and Gutman 2002)",
    "exponential_gain": "k (exp(u/s) - 1 - u/s) at the input (Shockley 1949)",
    "sinh_spring": "restoring force sinh(y/s)",
    "saturating_load": "offset that follows a measured load through a saturating curve",
    "warming_gain": "gain that settles exponentially while the device warms up",
    "two_harmonics": "hum with a second or third harmonic",
    "sqrt_drift": "drift with the square root of time",
}
NULL = {
    "first_order": "linear, first order",
    "second_order": "linear, second order",
    "oversampled": "linear, time constant of 60 to 120 samples",
    "resonant": "linear, damping 0.05 to 0.15",
    "offset": "linear, with a large constant in y",
    "delay": "linear, pure delay of 1 to 3 samples",
}
PAIRS = {
    "dead_zone+drift": "valve overlap and a sensor that drifts",
    "saturation+creep": "amplifier limit and creep",
    "hysteresis+channel:temperature": "piezo that warms up",
    "backlash+periodic_disturbance": "gear train with hum",
    "cubic_gain+coulomb_friction": "growing force constant and a dry guide",
    "asymmetric_gain+hardening_spring": "one-sided drive against a stiffening flexure",
    "ageing+quadratic_drag": "weakening drive in a fluid",
    "bilinear_gain+drift": "position-dependent force and a sensor that drifts",
    "quadratic_gain+creep": "magnetic force and creep",
    "channel_gain:temperature+stribeck_friction": "warm coil on a sticking guide",
    "dead_zone+backlash": "valve overlap, then a worn linkage",
    "saturation+backlash": "amplifier limit, then a worn gear train",
    "backlash+saturation": "worn lever, then a valve that is fully open",
    "dead_zone+saturation": "valve overlap and a full opening",
}
GROUPS = {"in": IN, "off": OFF, "null": NULL, "pair": PAIRS}

_OFF_ACCEPT = {
    "lugre_friction": {"coulomb_friction", "stribeck_friction", "stiction"},
    "tanh_friction": {"coulomb_friction"},
    "maxwell_slip": {"hysteresis"},
    "jiles_atherton": {"hysteresis"},
    "atan_saturation": {"saturation"},
    "log_creep": {"creep"},
    "soft_dead_zone": {"dead_zone"},
    "elastic_backlash": {"backlash"},
    "exponential_gain": {"quadratic_gain", "asymmetric_gain"},
    "sinh_spring": {"hardening_spring"},
    "saturating_load": {"channel:load"},
    "warming_gain": {"ageing"},
    "two_harmonics": {"periodic_disturbance"},
    "sqrt_drift": {"drift"},
}
_ACCEPT = {kind: frozenset({kind}) for kind in IN}
# Both truths stick, and break loose at more than moves them: that is what the catalogue calls stiction.
_ACCEPT["stribeck_friction"] = frozenset({"stribeck_friction", "coulomb_friction", "stiction"})
_ACCEPT.update({kind: frozenset(ids) for kind, ids in _OFF_ACCEPT.items()})

# Velocity needs a mass.
_SECOND_ORDER = {"coulomb_friction", "stribeck_friction", "quadratic_drag", "lugre_friction", "tanh_friction"}
# A force y^3 around the true zero is no pure cubic around a shifted one.
_NO_OFFSET = {"hardening_spring", "sinh_spring"}
_NEEDS_CHANNELS = {"channel:temperature", "channel_gain:temperature", "saturating_load"}


@dataclass(frozen=True)
class Case:
    """One record with a known truth."""

    name: str
    group: str  # "in", "off", "null" or "pair"
    accept: tuple[frozenset[str], ...]  # one set of right catalogue ids per hidden effect
    u: Array
    y: Array  # with noise
    clean: Array  # without noise
    bare: Array  # without noise and without the effect
    Ts: float
    channels: dict[str, Array]
    noise: str
    excitation: str
    info: dict[str, Any] = field(default_factory=dict)  # plant, effects with their parameters, sizes, "left"

    @property
    def size(self) -> float:
        """What all effects together add to the clean output, relative to the linear actuator's output."""
        return float(np.std(self.clean - self.bare) / np.std(self.bare))


@dataclass
class Plant:
    """The linear actuator, its solver and the scale of its signals."""

    order: int
    tau: float  # first order: time constant; second order: 1/wn
    zeta: float
    K: float
    delay: int  # samples
    offset: float  # in units of the output's standard deviation
    h: float  # step of the solver
    held: bool  # zero-order hold of the samples, or an analogue input
    u: Array  # samples of the input
    fine: Array  # the input on the solver's grid
    channels: dict[str, Array]
    Y: float = 1.0  # std of the linear output
    V: float = 1.0  # rms of its velocity
    A: float = 1.0  # amplitude of the input
    S: float = 0.0  # std of what an effect at the output adds at strength one and Y = 1; 0: as it is in this record

    def __post_init__(self) -> None:
        if self.order == 1:
            self.num, self.den = [1.0], [self.tau, 1.0]
        else:
            self.num, self.den = [1.0], [self.tau**2, 2 * self.zeta * self.tau, 1.0]

    @property
    def t(self) -> Array:
        """Time on the solver's grid."""
        return np.arange(len(self.fine)) * self.h

    def linear(self, drive: Array) -> Array:
        """Answer to a drive on the solver's grid, exact for a held or piecewise linear drive."""
        b, a, _ = cont2discrete((self.num, self.den), self.h, method="zoh" if self.held else "foh")
        return lfilter(np.ravel(b), a, drive)

    def step(self) -> tuple[float, ...]:
        """One step under a constant drive d: y <- a11 y + a12 v + b1 d, v <- a21 y + a22 v + b2 d."""
        if self.order == 1:
            a = math.exp(-self.h / self.tau)
            return a, 0.0, 0.0, 0.0, 1 - a, 0.0
        w = 1 / self.tau
        A = np.array([[0.0, 1.0], [-w * w, -2 * self.zeta * w]])
        Ad, Bd, *_ = cont2discrete((A, np.array([[0.0], [w * w]]), np.eye(2), np.zeros((2, 1))), self.h)
        return (*(float(x) for x in Ad.ravel()), float(Bd[0, 0]), float(Bd[1, 0]))

    def drives(self, drive: Array) -> list[float]:
        """Mean drive of every step."""
        return (drive[:-1] if self.held else 0.5 * (drive[:-1] + drive[1:])).tolist()

    def path(self, w: Array) -> Array:
        """The values a memory without a clock has to see: the samples of a held input, else the fine grid."""
        return w[::FINER] if self.held else w

    def spread(self, z: Array) -> Array:
        """Undo ``path``."""
        return np.repeat(z, FINER)[: len(self.fine)] if self.held else z


@dataclass
class Effect:
    """One hidden effect of adjustable strength; strength zero is the linear actuator.

    ``act(w, s)`` gives the changed input (``where`` = "input"), ``act(drive, s)`` the plant's output ("inside"), ``act(s)``
    what is added to the output ("output"), all on the solver's grid.
    """

    where: str
    act: Callable[..., Array]
    start: float = 0.1  # first guess of the strength
    params: dict[str, Any] = field(default_factory=dict)
    before: Callable[[Array], Array] | None = None  # linear dynamics that remain at strength zero
    unit: float = 0.0  # of an effect at the output: the std by which its signal was scaled


# ---- memories and solvers -------------------------------------------------------------------------------------------


def play(path: Array, r: float) -> Array:
    """Play of half-width r, starting at rest at zero (Krasnosel'skii and Pokrovskii 1989)."""
    out, w = [], 0.0
    for x in path.tolist():
        w = min(max(w, x - r), x + r)
        out.append(w)
    return np.array(out)


def _bw_rate(z: float, dx: float, beta: float, n: int) -> float:
    a = abs(z)
    a = a * a if n == 2 else a
    return dx * (1.0 - a * (beta + (1.0 - beta) * (1.0 if z * dx >= 0 else -1.0)))


def bouc_wen(path: Array, width: float, beta: float, n: int) -> Array:
    """Bouc-Wen memory in [-1, 1]: dz = dx/width (1 - |z|^n (beta + gamma sign(z dx))), beta + gamma = 1."""
    out, z, last = [], 0.0, 0.0
    for x in (path / width).tolist():
        dx = x - last
        m = 1 + int(abs(dx) / 0.05)
        d = dx / m
        for _ in range(m):
            z += _bw_rate(z + 0.5 * _bw_rate(z, d, beta, n), d, beta, n)
        last = x
        out.append(z)
    return np.array(out)


def maxwell_slip(path: Array, limits: Array, stiffness: Array) -> Array:
    """Sum of elastic sliders: each follows the path elastically up to its limit, then slips."""
    total = np.zeros(len(path))
    for r, k in zip(limits, stiffness, strict=True):
        total += k * (path - play(path, float(r)))
    return total


def jiles_atherton(path: Array, a: float, k: float, alpha: float, c: float) -> Array:
    """Magnetisation, 1 at saturation; Langevin's function is the anhysteretic curve (Jiles and Atherton 1986)."""

    def langevin(x: float) -> float:
        return x / 3 - x**3 / 45 if abs(x) < 0.05 else 1 / math.tanh(x) - 1 / x

    out, H, irreversible, M = [], 0.0, 0.0, 0.0
    for target in path.tolist():
        dH = target - H
        m = 1 + int(abs(dH) / (0.02 * k))
        d = dH / m
        for _ in range(m):
            H += d
            anhysteretic = langevin((H + alpha * M) / a)
            gap = anhysteretic - irreversible
            if gap * d > 0:  # else the wall motion would have negative susceptibility
                irreversible += gap / (math.copysign(k, d) - alpha * gap) * d
            M = (1 - c) * irreversible + c * anhysteretic
        H = target
        out.append(M)
    return np.array(out)


def elastic_play(fine: Array, r: float, h: float, tau: float, damping: float) -> Array:
    """Load with viscous friction behind a gap of half-width r; spring and damper act in contact.

    ``b q' = k p + d p'`` with the indentation ``p = dz(u - q, r)``, ``tau = b/k``, ``damping = d/b``. Implicit in q.
    """
    out, q, p = [], 0.0, 0.0
    stiff = h / tau + damping
    for u in fine.tolist():
        e = u - q
        if abs(e) <= r:
            p = 0.0
        else:
            e -= math.copysign(r, e)
            dq = (stiff * e - damping * p) / (1.0 + stiff)
            q += dq
            p = e - dq
        out.append(q)
    return np.array(out)


def smooth_inside(plant: Plant, drive: Array, force: Callable[[float, float, float], float]) -> Array:
    """Plant with a smooth internal force(y, v, drive): exponential integrator with the trapezoidal rule for the force."""
    a11, a12, a21, a22, b1, b2 = plant.step()
    y = v = 0.0
    out, bound = [0.0], 1e3 * plant.Y
    for d in plant.drives(drive):
        f = force(y, v, d)
        y1 = a11 * y + a12 * v + b1 * (d - f)
        v1 = a21 * y + a22 * v + b2 * (d - f)
        f = d - 0.5 * (f + force(y1, v1, d))
        y, v = a11 * y + a12 * v + b1 * f, a21 * y + a22 * v + b2 * f
        if not abs(y) < bound:
            return np.full(len(drive), np.inf)
        out.append(y)
    return np.array(out)


def dry_inside(plant: Plant, drive: Array, kinetic: float, static: float = 0.0, vs: float = 1.0) -> Array:
    """Plant with dry friction: the implicit step of Moreau (1988), in which the mass sticks at exactly zero velocity."""
    a11, a12, a21, a22, b1, b2 = plant.step()
    y = v = 0.0
    extra = max(static - kinetic, 0.0)
    out = [0.0]
    for d in plant.drives(drive):
        y1 = a11 * y + a12 * v + b1 * d
        v1 = a21 * y + a22 * v + b2 * d
        limit = kinetic + extra * math.exp(-((v / vs) ** 2)) if extra else kinetic
        f = v1 / b2
        if f > limit:
            f = limit
        elif f < -limit:
            f = -limit
        y, v = y1 - b1 * f, v1 - b2 * f
        out.append(y)
    return np.array(out)


def rubbing(
    u: Array, Ts: float, m: float, b: float, k: float, F: float | Array, kp: float = 0.0, kd: float = 0.0
) -> Array:
    """Return position and speed of a part that rubs, (N, 2): m x'' + b x' + k x + F sign(x') = u, at rest at first.

    F is a number or one per sample. With kp and kd a loop drives it: the force is kp (u - x) - kd x'. 40 implicit steps per sample (Moreau 1988).
    """
    h, x, v, out = Ts / 40, 0.0, 0.0, []
    for d, rubs in zip(u.tolist(), np.broadcast_to(F, u.shape).tolist(), strict=True):
        out.append((x, v))
        for _ in range(40):
            force = kp * (d - x) - kd * v if kp else d
            w = v + h * (force - b * v - k * x) / m
            v = math.copysign(max(abs(w) - h * rubs / m, 0.0), w)
            x += h * v
    return np.array(out)


def lugre_inside(plant: Plant, drive: Array, kinetic: float, static: float, vs: float, stiffness: float) -> Array:
    """Plant with LuGre friction; the bristles' stiffness is relative to the spring's, their damping ratio is one half."""
    a11, a12, a21, a22, b1, b2 = plant.step()
    h = plant.h
    damper = plant.tau * math.sqrt(stiffness)
    y = v = bristle = 0.0
    out = [0.0]
    for d in plant.drives(drive):
        last = bristle
        level = kinetic + (static - kinetic) * math.exp(-((v / vs) ** 2))
        bristle = (bristle + h * v) / (1.0 + h * stiffness * abs(v) / level)
        d -= stiffness * bristle + damper * (bristle - last) / h
        y, v = a11 * y + a12 * v + b1 * d, a21 * y + a22 * v + b2 * d
        out.append(y)
    return np.array(out)


def bouc_wen_inside(plant: Plant, drive: Array, force: float, width: float, beta: float, n: int) -> Array:
    """Plant with a Bouc-Wen restoring force driven by its own position."""
    a11, a12, a21, a22, b1, b2 = plant.step()
    y = v = z = 0.0
    out = [0.0]
    for d in plant.drives(drive):
        dx = (a11 * y + a12 * v + b1 * (d - force * z) - y) / width
        z1 = z + _bw_rate(z + 0.5 * _bw_rate(z, dx, beta, n), dx, beta, n)
        f = d - 0.5 * force * (z + z1)
        y1 = a11 * y + a12 * v + b1 * f
        v = a21 * y + a22 * v + b2 * f
        dx = (y1 - y) / width
        z += _bw_rate(z + 0.5 * _bw_rate(z, dx, beta, n), dx, beta, n)
        y = y1
        out.append(y)
    return np.array(out)


def lag(x: Array, tau: float, h: float) -> Array:
    """First-order lag with unit gain, at rest before the record, exact for a held input."""
    a = math.exp(-h / tau)
    return lfilter([0.0, 1 - a], [1.0, -a], x)


# ---- draws ----------------------------------------------------------------------------------------------------------


def _rng(seed: int, label: str, purpose: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(label.encode()), zlib.crc32(purpose.encode())])


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _slow(rng: np.random.Generator, N: int, Ts: float, cutoff: float, order: int = 3) -> Array:
    """Low-pass noise with unit standard deviation that starts in its stationary state."""
    lead = int(3 / (cutoff * Ts))
    sos = butter(order, min(2 * Ts * cutoff, 0.9), output="sos")
    x = sosfilt(sos, rng.standard_normal(N + lead))[lead:]
    return x / np.std(x)


def excite(rng: np.random.Generator, kind: str, N: int, Ts: float, bandwidth: float) -> Array:
    """Input of about unit amplitude that starts at zero; ``bandwidth`` of the actuator in Hz."""
    t = np.arange(N) * Ts
    if kind == "random":
        # The slow part and the slow envelope let it dwell near many amplitudes, with many reversals there.
        x = _slow(rng, N, Ts, bandwidth * rng.uniform(0.8, 1.6))
        envelope = 0.25 + np.abs(_slow(rng, N, Ts, 0.15 * bandwidth))
        u = x * envelope + rng.uniform(0.3, 0.8) * _slow(rng, N, Ts, 0.12 * bandwidth)
    elif kind == "sine":
        if rng.random() < 0.4:
            low, high = 0.08 * bandwidth, 1.6 * bandwidth
            rise = math.log(high / low)
            sweep = t[-1] / 2  # twice, whole cycles each
            cycles = max(1, round((high - low) * sweep / rise))
            u = np.sin(2 * np.pi * cycles * np.expm1(rise * np.mod(t, sweep) / sweep) / math.expm1(rise))
        else:
            u = np.zeros(N)
            for _ in range(rng.integers(2, 6)):
                f = bandwidth * _log_uniform(rng, 0.1, 1.4)
                u += rng.uniform(0.5, 1.0) * np.sin(2 * np.pi * (f * t + rng.random()))
        f = rng.uniform(0.05, 0.12)
        u = u * (1 + rng.uniform(0.2, 0.6) * np.sin(2 * np.pi * (f * t + rng.random())))
    elif kind == "steps":
        u, start = np.zeros(N), int(0.3 / Ts)
        while start < N:
            stop = start + max(1, round(rng.uniform(0.3, 1.0) / Ts))
            u[start:stop] = rng.uniform(-1, 1)
            start = stop
        if rng.random() < 0.5:  # the drive rounds the steps; what it delivers is measured
            u = lag(u, rng.uniform(0.02, 0.04), Ts)
    else:
        raise ValueError(f"excitation must be one of {EXCITATIONS}, not {kind!r}")
    if rng.random() < 0.3:
        u = u + rng.uniform(-0.3, 0.3) * np.quantile(np.abs(u), 0.99)
    u = u * -np.expm1(-t / 0.3)
    return u / np.quantile(np.abs(u), 0.99)


def colour(rng: np.random.Generator, kind: str, N: int) -> Array:
    """Noise of unit rms."""
    lead = 5000
    e = rng.standard_normal(N + lead)
    if kind == "white":
        x = e
    elif kind in ("ar95", "ar80"):
        x = lfilter([1.0], [1.0, -0.95 if kind == "ar95" else -0.8], e)
    elif kind == "band":
        f = rng.uniform(0.03, 0.2)  # cycles per sample
        x = lfilter([1.0], [1.0, -2 * 0.97 * math.cos(2 * np.pi * f), 0.97**2], e)
    elif kind == "drifting":
        wander = lfilter([1.0], [1.0, -0.999], rng.standard_normal(N + lead)) * math.sqrt(1 - 0.999**2)
        x = e + rng.uniform(0.3, 0.5) * wander
    else:
        raise ValueError(f"noise must be one of {NOISES}, not {kind!r}")
    x = x[lead:]
    return x / math.sqrt(float(np.mean(x**2)))


def _channels(rng: np.random.Generator, N: int, Ts: float) -> dict[str, Array]:
    """Temperature in degrees and load in newtons, both slow."""
    span = N * Ts
    temperature = _slow(rng, N, Ts, rng.uniform(3, 6) / span)
    load = _slow(rng, N, Ts, rng.uniform(4, 9) / span)
    return {"temperature": 25 + 4 * temperature, "load": 50 + 20 * load}


def _plant(rng: np.random.Generator, kinds: tuple[str, ...], null: str | None, Ts: float) -> dict[str, Any]:
    order = int(rng.integers(1, 3))
    tau = float(rng.uniform(0.08, 0.20))
    period = float(rng.uniform(0.05, 0.12))
    zeta = float(rng.uniform(0.5, 0.9))
    K = float(rng.uniform(0.5, 3.0))
    offset = _sign(rng) * float(rng.uniform(0.5, 2.0)) if rng.random() < 0.4 else 0.0
    delay = 0
    if null in ("first_order", "second_order"):
        order = 1 if null == "first_order" else 2
    elif null == "oversampled":
        order, tau = 1, float(rng.uniform(60, 120)) * Ts
    elif null == "resonant":
        order, zeta = 2, float(rng.uniform(0.05, 0.15))
    elif null == "offset":
        offset = _sign(rng) * float(rng.uniform(2.0, 6.0))
    elif null == "delay":
        delay = int(rng.integers(1, 4))
    if _SECOND_ORDER & set(kinds):
        order = 2
    if _NO_OFFSET & set(kinds):
        offset = 0.0
    return {
        "order": order,
        "tau": tau if order == 1 else period,
        "zeta": zeta if order == 2 else 1.0,
        "K": K,
        "delay": delay,
        "offset": offset,
    }


# ---- effects --------------------------------------------------------------------------------------------------------


def _added(plant: Plant, shape: Callable[[Array], Array], **params: Any) -> Effect:
    """Input effect u + s * shape(u), the shape scaled to the input's amplitude."""
    return Effect("input", lambda w, s: w + s * plant.A * shape(w), params=params)


def _output(plant: Plant, signal: Array, **params: Any) -> Effect:
    """Output effect s * signal, the signal scaled to the output."""
    unit = plant.S or float(np.std(signal))
    signal = signal * (plant.Y / unit)
    return Effect("output", lambda s: s * signal, params=params, unit=unit)


def _force(plant: Plant, make: Callable[[float], Callable[[float, float, float], float]], **params: Any) -> Effect:
    """Internal smooth force; ``make(s)`` gives force(y, v, drive)."""
    return Effect("inside", lambda drive, s: smooth_inside(plant, drive, make(s)), params=params)


def _between(plant: Plant, channel: str) -> Array:
    """Standardised channel on the solver's grid."""
    x = plant.channels[channel]
    return np.interp(np.arange(len(plant.fine)) / FINER, np.arange(len(x)), (x - x.mean()) / x.std())


def _hysteresis(rng: np.random.Generator, p: Plant) -> Effect:
    at = ("output", "input", "inside")[int(rng.integers(3))]
    width, beta, n = float(rng.uniform(0.15, 0.5)), float(rng.uniform(0.5, 0.9)), int(rng.integers(1, 3))
    params = {"at": at, "width": width, "beta": beta, "n": n}

    def memory(w: Array) -> Array:
        return p.spread(bouc_wen(p.path(w), width * p.A, beta, n))

    if at == "output":
        return _output(p, memory(p.fine), **params)
    if at == "input":
        return _added(p, memory, **params)
    return Effect("inside", lambda d, s: bouc_wen_inside(p, d, s * p.Y, 2 * width * p.Y, beta, n), params=params)


def _saturation(rng: np.random.Generator, p: Plant) -> Effect:
    if rng.random() < 0.5:
        return Effect("input", lambda w, s: np.clip(w, -p.A / s, p.A / s), start=1.5, params={"form": "hard"})
    return Effect("input", lambda w, s: p.A / s * np.tanh(w * s / p.A), start=0.7, params={"form": "tanh"})


def _stribeck(rng: np.random.Generator, p: Plant) -> Effect:
    ratio, vs = float(rng.uniform(1.5, 3.0)), float(rng.uniform(0.1, 0.4)) * p.V

    def act(drive: Array, s: float) -> Array:
        return dry_inside(p, drive, s * p.Y, ratio * s * p.Y, vs)

    return Effect("inside", act, params={"static_over_kinetic": ratio, "vs": vs})


def _lugre(rng: np.random.Generator, p: Plant) -> Effect:
    ratio, vs = float(rng.uniform(1.1, 1.6)), float(rng.uniform(0.05, 0.3)) * p.V
    stiffness = _log_uniform(rng, 30, 120)

    def act(drive: Array, s: float) -> Array:
        return lugre_inside(p, drive, s * p.Y, ratio * s * p.Y, vs, stiffness)

    return Effect("inside", act, params={"static_over_kinetic": ratio, "vs": vs, "stiffness": stiffness})


def _hardening(p: Plant) -> Effect:
    def make(s: float) -> Callable[[float, float, float], float]:
        c = s / p.Y**2
        return lambda y, v, d: c * y * y * y

    return _force(p, make)


def _sinh(rng: np.random.Generator, p: Plant) -> Effect:
    scale = float(rng.uniform(0.7, 1.3)) * p.Y

    def make(s: float) -> Callable[[float, float, float], float]:
        # The argument is bounded only against overflow of a trial strength.
        return lambda y, v, d: s * (scale * math.sinh(min(max(y / scale, -50.0), 50.0)) - y)

    return _force(p, make, scale=scale)


def _quadratic_spring(rng: np.random.Generator, p: Plant) -> Effect:
    sign = _sign(rng)

    def make(s: float) -> Callable[[float, float, float], float]:
        c = sign * s / p.Y
        return lambda y, v, d: c * y * y

    return _force(p, make, sign=sign)


def _bilinear(rng: np.random.Generator, p: Plant) -> Effect:
    sign = _sign(rng)

    def make(s: float) -> Callable[[float, float, float], float]:
        c = -sign * s / p.Y
        return lambda y, v, d: c * y * d

    return _force(p, make, sign=sign)


def _drag(p: Plant) -> Effect:
    def make(s: float) -> Callable[[float, float, float], float]:
        c = s * p.Y / p.V**2
        return lambda y, v, d: c * v * abs(v)

    return _force(p, make)


def _tanh_friction(rng: np.random.Generator, p: Plant) -> Effect:
    vs = float(rng.uniform(0.05, 0.3)) * p.V

    def make(s: float) -> Callable[[float, float, float], float]:
        c, tanh = s * p.Y, math.tanh
        return lambda y, v, d: c * tanh(v / vs)

    return _force(p, make, vs=vs)


def _creep(rng: np.random.Generator, p: Plant) -> Effect:
    tau = _log_uniform(rng, 0.5, 2.0)
    return _output(p, sum(lag(p.fine, m * tau, p.h) for m in (1, 3, 9)), tau=tau)


def _log_creep(rng: np.random.Generator, p: Plant) -> Effect:
    power = float(rng.uniform(-0.3, 0.15))  # zero: logarithmic in time
    taus = np.geomspace(0.2, 80.0, 20)
    return _output(p, sum(tau**power * lag(p.fine, tau, p.h) for tau in taus), power=power)


def _hum(rng: np.random.Generator, p: Plant, harmonic: bool) -> Effect:
    f = _log_uniform(rng, 0.6, 8.0)
    phases = 2 * np.pi * rng.random(2)
    x = np.sin(2 * np.pi * f * p.t + phases[0])
    if not harmonic:
        return _output(p, x, frequency=f)
    m, part = int(rng.integers(2, 4)), float(rng.uniform(0.3, 0.5))
    return _output(p, x + part * np.sin(2 * np.pi * m * f * p.t + phases[1]), frequency=f, harmonic=m, part=part)


def _maxwell(rng: np.random.Generator, p: Plant) -> Effect:
    n = int(rng.integers(6, 11))
    limits = np.linspace(0.05, float(rng.uniform(0.6, 1.0)), n)
    stiffness = rng.uniform(0.3, 1.0, n)
    z = p.spread(maxwell_slip(p.path(p.fine), limits * p.A, stiffness))
    return _output(p, z, limits=limits.tolist(), stiffness=stiffness.tolist())


def _jiles_atherton(rng: np.random.Generator, p: Plant) -> Effect:
    a, k = float(rng.uniform(0.4, 0.8)), float(rng.uniform(0.3, 0.6))
    alpha, c = float(rng.uniform(0.05, 0.3)), float(rng.uniform(0.05, 0.25))

    def memory(w: Array) -> Array:
        return p.spread(jiles_atherton(p.path(w) / p.A, a, k, alpha, c))

    return _added(p, memory, a=a, k=k, alpha=alpha, c=c)


def _soft_dead_zone(rng: np.random.Generator, p: Plant) -> Effect:
    soft = float(rng.uniform(0.1, 0.3))

    def act(w: Array, s: float) -> Array:
        if s == 0:
            return w
        r, corner = s * p.A, soft * s * p.A
        return corner * (np.logaddexp(0, (w - r) / corner) - np.logaddexp(0, (-w - r) / corner))

    return Effect("input", act, params={"corner": soft})


def _elastic_backlash(rng: np.random.Generator, p: Plant) -> Effect:
    tau, damping = float(rng.uniform(0.005, 0.02)), float(rng.uniform(0.05, 0.4))

    def act(w: Array, s: float) -> Array:
        return elastic_play(w, s * p.A, p.h, tau, damping)

    return Effect("input", act, params={"contact_tau": tau, "damping": damping}, before=lambda w: act(w, 0.0))


def _exponential_gain(rng: np.random.Generator, p: Plant) -> Effect:
    scale, sign = float(rng.uniform(0.7, 1.5)), _sign(rng)
    return _added(p, lambda w: sign * (np.expm1(w / (scale * p.A)) - w / (scale * p.A)), scale=scale, sign=sign)


def _shaped(rng: np.random.Generator, p: Plant, power: int) -> Effect:
    sign = _sign(rng)
    shape = {1: np.abs, 2: np.square}[power]
    return _added(p, lambda w: sign * shape(w / p.A), sign=sign)


def _gain(rng: np.random.Generator, p: Plant, x: Array, **params: Any) -> Effect:
    sign = _sign(rng)
    return _added(p, lambda w: sign * x * w / p.A, sign=sign, **params)


def _warming(rng: np.random.Generator, p: Plant) -> Effect:
    settle = float(rng.uniform(0.25, 0.8))
    return _gain(rng, p, -np.expm1(-p.t / (settle * p.t[-1])), settle=settle)


def _signed_output(rng: np.random.Generator, p: Plant, x: Array) -> Effect:
    return _output(p, _sign(rng) * x)


def _saturating_load(rng: np.random.Generator, p: Plant) -> Effect:
    x = _between(p, "load")
    return _output(p, _sign(rng) * np.tanh((x - rng.uniform(-0.3, 0.3)) / rng.uniform(0.5, 1.2)))


_EFFECTS: dict[str, Callable[[np.random.Generator, Plant], Effect]] = {
    "backlash": lambda rng, p: Effect("input", lambda w, s: p.spread(play(p.path(w), s * p.A))),
    "coulomb_friction": lambda rng, p: Effect("inside", lambda d, s: dry_inside(p, d, s * p.Y)),
    "stribeck_friction": _stribeck,
    "quadratic_drag": lambda rng, p: _drag(p),
    "hardening_spring": lambda rng, p: _hardening(p),
    "quadratic_spring": _quadratic_spring,
    "bilinear_gain": _bilinear,
    "dead_zone": lambda rng, p: Effect("input", lambda w, s: w - np.clip(w, -s * p.A, s * p.A)),
    "saturation": _saturation,
    "asymmetric_gain": lambda rng, p: _shaped(rng, p, 1),
    "quadratic_gain": lambda rng, p: _shaped(rng, p, 2),
    "cubic_gain": lambda rng, p: _added(p, lambda w: (w / p.A) ** 3),
    "hysteresis": _hysteresis,
    "creep": _creep,
    "drift": lambda rng, p: _signed_output(rng, p, p.t),
    "periodic_disturbance": lambda rng, p: _hum(rng, p, harmonic=False),
    "channel:temperature": lambda rng, p: _signed_output(rng, p, _between(p, "temperature")),
    "channel_gain:temperature": lambda rng, p: _gain(rng, p, _between(p, "temperature")),
    "ageing": lambda rng, p: _gain(rng, p, p.t / p.t[-1]),
    "lugre_friction": _lugre,
    "tanh_friction": _tanh_friction,
    "maxwell_slip": _maxwell,
    "jiles_atherton": _jiles_atherton,
    "atan_saturation": lambda rng, p: Effect(
        "input", lambda w, s: 2 * p.A / (np.pi * s) * np.arctan(np.pi * s / (2 * p.A) * w), start=0.5
    ),
    "log_creep": _log_creep,
    "soft_dead_zone": _soft_dead_zone,
    "elastic_backlash": _elastic_backlash,
    "exponential_gain": _exponential_gain,
    "sinh_spring": _sinh,
    "saturating_load": _saturating_load,
    "warming_gain": _warming,
    "two_harmonics": lambda rng, p: _hum(rng, p, harmonic=True),
    "sqrt_drift": lambda rng, p: _signed_output(rng, p, np.sqrt(p.t)),
}


# ---- cases ----------------------------------------------------------------------------------------------------------


def _simulate(plant: Plant, effects: list[tuple[Effect, float | None]]) -> Array:
    """Output on the solver's grid; strength None is the linear actuator with what remains at strength zero."""
    w = plant.fine
    if plant.delay:
        w = np.concatenate([np.zeros(plant.delay * FINER), w[: -plant.delay * FINER]])
    for e, s in effects:
        if e.where == "input":
            if s is not None:
                w = e.act(w, s)
            elif e.before is not None:
                w = e.before(w)
    drive = plant.K * w
    inside = [(e, s) for e, s in effects if e.where == "inside" and s is not None]
    if len(inside) > 1:
        raise ValueError("only one internal effect at a time")
    y = inside[0][0].act(drive, inside[0][1]) if inside else plant.linear(drive)
    for e, s in effects:
        if e.where == "output" and s is not None:
            y = y + e.act(s)
    return y


def _calibrate(size: Callable[[float], float], target: float, start: float) -> float:
    """Strength at which the effect has the wanted size; size grows with strength."""
    low = high = None
    s = start
    for _ in range(40):
        r = size(s)
        if math.isfinite(r) and abs(r / target - 1) < 0.5 * TOLERANCE:
            return s
        if r < target:
            low = (s, r)
        else:
            high = (s, r)
        if low and high:
            part = 0.5
            if low[1] > 1e-3 * target and math.isfinite(high[1]):
                part = math.log(target / low[1]) / math.log(high[1] / low[1])
            s = low[0] * (high[0] / low[0]) ** min(max(part, 0.05), 0.95)
        elif low:
            s *= min(max(target / r if r > 0 else 2.0, 1.02), 2.0)
        else:
            s *= max(min(target / r if math.isfinite(r) else 0.5, 0.98), 0.25)
    raise RuntimeError(f"no strength gives the size {target:.3f}")


def _left(plant: Plant, bare: Array, change: Array) -> float:
    """Share of the output that a refit of gain, poles, zeros and offset cannot absorb, to first order."""
    b, a, _ = cont2discrete((plant.num, plant.den), plant.h * FINER)
    once = lfilter(np.ravel(b), a, bare)
    columns = [np.ones_like(bare)]
    for x in (bare, once):
        columns += [np.concatenate([np.zeros(m), x[: len(x) - m]]) for m in range(3)]
    X = np.stack(columns, axis=1)
    return float(np.std(change - X @ np.linalg.lstsq(X, change, rcond=None)[0]) / np.std(bare))


def case(
    group: str,
    kind: str,
    seed: int,
    excitation: str = "random",
    noise: str = "white",
    level: float = 0.01,
    N: int = 4000,
    Ts: float = 0.01,
) -> Case:
    """Simulate one truth.

    ``level`` is the rms of the noise relative to the standard deviation of the clean output.
    """
    if kind not in GROUPS[group]:
        raise ValueError(f"{kind!r} is no kind of the group {group!r}")
    kinds = () if group == "null" else tuple(kind.split("+"))
    label = f"{group}/{kind}"
    draw = _plant(_rng(seed, label, "plant"), kinds, kind if group == "null" else None, Ts)
    amplitude = _log_uniform(rng := _rng(seed, label, "input"), 1.0, 5.0)
    held = bool(rng.random() < 0.5) or excitation == "steps"
    u = amplitude * excite(_rng(seed, label, excitation), excitation, N, Ts, 1 / (2 * np.pi * draw["tau"]))
    grid = np.arange((N - 1) * FINER + 1)
    fine = u[grid // FINER] if held else CubicSpline(np.arange(N), u)(grid / FINER)
    rng = _rng(seed, label, "channels")
    channels: dict[str, Array] = {}
    if rng.random() < (0.5 if group == "null" else 0.3) or _NEEDS_CHANNELS & set(kinds):
        channels = _channels(rng, N, Ts)
    plant = Plant(**draw, h=Ts / FINER, held=held, u=u, fine=fine, channels=channels, A=amplitude)
    y = plant.linear(plant.K * fine)
    plant.Y, plant.V = float(np.std(y)), float(np.std(np.diff(y))) / plant.h

    rng = _rng(seed, label, "effect")
    low, high = SIZE_PAIR if group == "pair" else SIZE
    effects: list[tuple[Effect, float | None]] = []
    told = []
    for k in kinds:
        target = _log_uniform(rng, low, high)
        effect = _EFFECTS[k](rng, plant)
        alone = _simulate(plant, [(effect, None)])[::FINER]
        scale = float(np.std(alone))

        def size(s: float, effect: Effect = effect, alone: Array = alone, scale: float = scale) -> float:
            changed = _simulate(plant, [(effect, s)])[::FINER]
            return float(np.std(changed - alone)) / scale if np.isfinite(changed[-1]) else math.inf

        strength = _calibrate(size, target, effect.start)
        effects.append((effect, strength))
        told.append({"kind": k, "where": effect.where, "size": size(strength), "strength": strength, **effect.params})

    bare = _simulate(plant, [(e, None) for e, _ in effects])[::FINER]
    clean = _simulate(plant, effects)[::FINER] if effects else bare
    left = _left(plant, bare, clean - bare) if effects else 0.0
    offset = plant.offset * plant.Y
    bare, clean = bare + offset, clean + offset
    y = clean + level * np.std(clean) * colour(_rng(seed, label, "noise " + noise), noise, N)
    # The sensors of the channels have noise of their own.
    measured = {
        name: x + 0.005 * np.std(x) * _rng(seed, label, "measured " + name).standard_normal(N)
        for name, x in channels.items()
    }
    name = f"{label}/{excitation}/s{seed}" + ("" if noise == "white" else f"/{noise}")
    info = {**draw, "offset": offset, "held": held, "amplitude": amplitude, "effects": told, "left": left}
    accept = tuple(_ACCEPT[k] for k in kinds)
    return Case(name, group, accept, u, y, clean, bare, Ts, measured, noise, excitation, info)


def battery(group: str, seeds: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Arguments of ``case``, one per kind and seed.

    Excitations rotate, and so do noise colours: white in every second run, in ``null`` every colour equally (15 consecutive
    seeds cover all excitations with all colours). One run in four is sampled twice as fast; half have 0.5 % noise, half 1 %.
    """
    seeds = tuple(seeds)
    others = [n for n in NOISES if n != "white"]
    mixed = [n for other in others for n in ("white", other)]
    for i, kind in enumerate(GROUPS[group]):
        for seed in seeds:
            m = seed + i
            yield {
                "group": group,
                "kind": kind,
                "seed": seed,
                "excitation": EXCITATIONS[m % 3],
                "noise": NOISES[m % 5] if group == "null" else mixed[m % 8],
                "level": (0.01, 0.005)[(m // 2) % 2],
                "Ts": (0.01, 0.01, 0.01, 0.005)[(m // 3) % 4],
            }
