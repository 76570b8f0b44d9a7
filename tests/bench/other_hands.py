"""Machines that other hands wrote: MuJoCo's actuators, joints and tendons, and parts of the Modelica Standard Library.

    pip install "mujoco<4" rumoca; git clone https://github.com/modelica/ModelicaStandardLibrary
    python tests/bench/other_hands.py [--seed 1] [--each 2] [--nulls 2] [--kinds "a;b"] [--msl ModelicaStandardLibrary]

Each goes the way of a user: `identify(record, base="linear")`, then `diagnose`, all defaults. The tables below say what is
in each machine, and which names of the catalogue are right, by physics: friction whose static force is the larger one may be
called any of three names, as in `truths.py`; of a pendulum sin(y) is a spring that softens; a state that is clamped behind a
lag is a saturation or an end stop. A machine is driven so hard, or so softly, that its effect adds 6 to 25 % to the output
(of what it does where the effect vanishes), with 0.5 to 2 % of white noise, 1500 to 3000 samples, 20 to 50 of them in a
period of the machine. MuJoCo holds the input between samples; Modelica reads a multisine. *Visible*: the refitted base
leaves at least half the noise power beside the noise, held out, as in `battery.py`. Without --msl only MuJoCo is asked. The
library's parts with dry friction are left out: rumoca 0.10 keeps them at rest for ever once they have stopped.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from time import perf_counter
from typing import Any

import common
import numpy as np
from scipy.signal import butter, sosfiltfilt

import narx_sym as ns

Array = np.ndarray
HARDER, SOFTER = 1, -1  # whether an effect grows with the size of the input, or falls
PLAIN = {HARDER: 1e-3, SOFTER: 1e6}  # where an effect has vanished [of a unit input]
SIZES = (1e-2, 1e4)  # that are searched
SURE = 0.8

# ---- MuJoCo; k, c: stiffness and damping of a mass of 1, w: frequency [rad/s]; see `machine` -----------------------------

MJCF = """<mujoco><compiler angle="radian"/><option integrator="implicitfast" {option}/><worldbody>{more}
<body><joint name="j" type="{type}" axis="0 1 0" stiffness="{spring}" damping="{damper}" {joint}/>
<geom type="box" size=".1 .1 .1" mass="{mass}" contype="0" conaffinity="0" {at}/></body></worldbody>{wires}
<actuator>{drive}</actuator><sensor>{read}</sensor></mujoco>"""
DEFAULT = {
    "option": 'gravity="0 0 0"', "more": "", "type": "slide", "spring": "{k}", "damper": "{c}", "joint": "", "mass": "1", "at": "",
    "wires": "", "drive": '<motor joint="j"/>', "read": '<jointpos joint="j"/>',
}  # fmt: skip
SPEED = {"spring": "0", "read": '<jointvel joint="j"/>'}
BESIDE = """<body><joint name="{n}" type="slide" axis="0 1 0" stiffness="{s}" damping="{d}"/>
<geom type="box" size=".1 .1 .1" mass="{m}" contype="0" conaffinity="0"/></body>"""
MOTOR = BESIDE.format(n="a", s="{k}", d="{c}", m="1")
SERVO = BESIDE.format(n="a", s="0", d="0", m=".1")
HOLD = '<position joint="a" kp="1000" dampratio="1"/>'
LIGHT = {"more": MOTOR, "drive": '<motor joint="a"/>', "spring": "0"}


def between(one: str, attributes: str) -> str:
    """Return a tendon from a joint to the load."""
    ends = f'<joint joint="{one}" coef="1"/><joint joint="j" coef="-1"/>'
    return f"<tendon><fixed {attributes}>{ends}</fixed></tendon>"


def cam(curve: str) -> dict[str, str]:
    """Return a servo that turns a cam, which pulls the load through a spring."""
    follower = BESIDE.format(n="b", s="0", d="0", m=".1")
    shape = f'<equality><joint joint1="b" joint2="a" polycoef="{curve}"/></equality>'
    pull = between("b", 'stiffness="{k}" springlength="0 0"')
    return {"more": SERVO + follower, "wires": shape + pull, "drive": HOLD, "spring": "0"}


DC = '<dcmotor joint="j" resistance="1" motorconst="1" {}/>'
FRICTION = ("coulomb_friction", "stribeck_friction", "stiction")
LUGRE = {"option": 'gravity="0 0 0" timestep="0.0005"', "drive": DC.format('lugre="{s0} {s1} 1 {static} {slow}"')}
MUJOCO: dict[str, tuple[tuple[str, ...], int, dict[str, str]]] = {
    "dry friction of a joint": (("coulomb_friction",), SOFTER, {"joint": 'frictionloss="1"'}),
    "dry friction, speed": (("coulomb_friction",), SOFTER, SPEED | {"joint": 'frictionloss="1"'}),
    "LuGre friction of a DC motor": (FRICTION, SOFTER, LUGRE),
    "LuGre friction, speed": (FRICTION, SOFTER, SPEED | LUGRE),
    "clamped control": (("saturation",), HARDER, {"drive": '<motor joint="j" ctrlrange="-1 1"/>'}),
    "clamped force, two limits": (("saturation",), HARDER, SPEED | {"drive": '<motor joint="j" forcerange="-1 {limit}"/>'}),
    "joint limits": (("end_stop",), HARDER, {"joint": 'range="-1 1"'}),
    "one joint limit": (("end_stop",), HARDER, {"joint": 'range="-1000 1"'}),
    "free play before a load": (("backlash",), SOFTER, LIGHT | {"mass": ".01", "damper": ".5", "wires": between("a", 'range="-1 1"')}),
    "spring with a dead band": (("backlash",), SOFTER, LIGHT | {"mass": ".01", "damper": "2", "wires": between("a", 'stiffness="200" springlength="-1 1"')}),
    "dead band before a sprung load": (("dead_zone",), SOFTER, {"more": SERVO, "drive": HOLD, "wires": between("a", 'stiffness="{weak}" springlength="-1 1"')}),
    "pendulum": (("gravity", "hardening_spring"), HARDER, {"type": "hinge", "at": 'pos="0 0 -1"', "option": 'gravity="0 0 -{k}"', "spring": "0"}),
    "fluid": (("quadratic_drag",), HARDER, {"option": 'gravity="0 0 0" density="100"'}),
    "fluid, speed": (("quadratic_drag",), HARDER, SPEED | {"option": 'gravity="0 0 0" density="100"'}),
    "damper of second degree": (("quadratic_drag",), HARDER, {"damper": "{c} 1 0"}),
    "spring of third degree": (("hardening_spring",), HARDER, {"spring": "{k} 0 {k}"}),
    "spring of second degree": (("quadratic_spring",), HARDER, {"spring": "{k} {k} 0"}),
    "slew rate of a servo": (("rate_limit",), HARDER, {"spring": "0", "damper": "0", "drive": DC.format('input="pos" controller="{k} 0 {c} 1 0 0"')}),
    "gain that depends on position": (("bilinear_gain",), HARDER, {"drive": '<general joint="j" gaintype="affine" gainprm="1 1 0"/>'}),
    "clipped sensor": (("output_limit",), HARDER, {"read": '<jointpos joint="j" cutoff="1"/>'}),
    "clamped activation": (("saturation", "end_stop"), HARDER, {"drive": '<general joint="j" dyntype="filterexact" dynprm="{tau}" actlimited="true" actrange="-1 1"/>'}),
    "winding that warms": (("ageing",), HARDER, SPEED | {"drive": DC.format('thermal="1 0 {third} 1 25 25"')}),
    "cam of second degree": (("quadratic_gain",), HARDER, cam("0 1 1 0 0")),
    "cam of third degree": (("cubic_gain",), HARDER, cam("0 1 0 1 0")),
}  # fmt: skip
LINEAR: dict[str, dict[str, str]] = {
    "spring and damper": {},
    "motor, speed": SPEED | {"drive": DC.format("")},
    "motor with an inductance, speed": SPEED | {"drive": DC.format('inductance="0 {tau}"')},
    "servo": {"spring": "0", "damper": "0", "drive": DC.format('input="pos" controller="{k} 0 {c} 0 0 0"')},
    "filtered force": {"drive": '<general joint="j" dyntype="filterexact" dynprm="{tau}"/>'},
    "two masses": {
        "more": BESIDE.format(n="a", s="0", d="{c}", m="1"), "drive": '<motor joint="a"/>',
        "wires": between("a", 'stiffness="{k}" damping="{c}" springlength="0 0"'),
    },
    "viscous fluid": {"option": 'gravity="0 0 0" viscosity="3"'},
    "delayed command": {"drive": '<motor joint="j" nsample="100" delay="{late}"/>'},
}  # fmt: skip


def mujoco_machine(slots: dict[str, str], put: dict[str, float], u: Array, Ts: float) -> Callable[[float], Array]:
    """Return the output of a machine for an input of some size."""
    import mujoco

    mujoco.set_mju_user_warning(lambda said: None)  # what becomes unstable while its size is searched
    text = MJCF.format(**DEFAULT | slots).format(**put)
    model = mujoco.MjModel.from_xml_string(text)
    steps = round(Ts / model.opt.timestep)

    def run(size: float) -> Array:
        data, out = mujoco.MjData(model), np.empty(u.size)
        for i, value in enumerate(size * u):
            data.ctrl[0] = value
            mujoco.mj_step(model, data, steps)
            out[i] = data.sensordata[0]
        return out

    return run


# ---- Modelica: parts of the Standard Library, driven by a multisine ------------------------------------------------------

SINES = 8
SERVICES = """package ModelicaServices package Machine constant Real eps=1e-15; constant Real small=1e-60;
constant Real inf=1e60; constant Integer Integer_inf=2147483647; end Machine; end ModelicaServices;
"""
MODEL = SERVICES + """model M output Real u; output Real y;
parameter Real size = 1; {parts} equation u = size*({wave}); {equations} end M;"""  # fmt: skip
SLIDE, TURN = "Modelica.Mechanics.Translational.", "Modelica.Mechanics.Rotational."
MASS = f"""{SLIDE}Components.Mass m(m=1, s(fixed=true, start=0), v(fixed=true, start=0)); {SLIDE}Sources.Force drive;
{SLIDE}Components.SpringDamper held(c={{k}}, d={{c}}); {SLIDE}Components.Fixed ground; """
SHAFT = f"""{TURN}Components.Inertia m(J=1, phi(fixed=true, start=0), w(fixed=true, start=0)); {TURN}Sources.Torque drive;
{TURN}Components.SpringDamper held(c={{k}}, d={{c}}); {TURN}Components.Fixed ground; """
HELD = "connect(drive.flange, m.flange_a); connect(held.flange_a, ground.flange); connect(held.flange_b, m.flange_b); "
LAG = "Modelica.Blocks.Continuous.SecondOrder lag(w={w}, D={zeta}); "
CHAIN = "part.u = u; lag.u = part.y; y = lag.y;"
MODELICA: dict[str, tuple[tuple[str, ...], int, str, str]] = {
    "QuadraticSpeedDependentForce": (("quadratic_drag",), HARDER, MASS + f"{SLIDE}Sources.QuadraticSpeedDependentForce part("
                                     "f_nominal=-1, v_nominal=1, ForceDirection=false);",
                                     HELD + "drive.f = u; connect(part.flange, m.flange_a); y = m.s;"),
    "ElastoGap": (("end_stop",), HARDER, MASS + f"{SLIDE}Components.ElastoGap part(c={{stiff}}, d=20, s_rel0=-1);",
                  HELD + "drive.f = u; connect(part.flange_a, ground.flange); connect(part.flange_b, m.flange_b); y = m.s;"),
    "ElastoBacklash": (("backlash",), SOFTER, SHAFT + f"{TURN}Components.Inertia load(J=.01, phi(fixed=true, start=0), "
                       f"w(fixed=true, start=0)); {TURN}Components.Damper oil(d=.5); {TURN}Components.ElastoBacklash part("
                       "c={stiff}, d=5, b=2);",
                       HELD + "drive.tau = u; connect(part.flange_a, m.flange_b); connect(part.flange_b, load.flange_a); "
                       "connect(oil.flange_a, ground.flange); connect(oil.flange_b, load.flange_b); y = load.phi;"),
    "DeadZone": (("dead_zone",), SOFTER, LAG + "Modelica.Blocks.Nonlinear.DeadZone part(uMax=1);", CHAIN),
    "Limiter": (("saturation",), HARDER, LAG + "Modelica.Blocks.Nonlinear.Limiter part(uMax=1);", CHAIN),
    "SlewRateLimiter": (("rate_limit",), HARDER, LAG + "Modelica.Blocks.Nonlinear.SlewRateLimiter part(Rising={w});", CHAIN),
}  # fmt: skip
LINEAR_MODELICA = {
    "Mass, SpringDamper": (MASS, HELD + "drive.f = u; y = m.s;"),
    "FirstOrder, SecondOrder": (LAG + "Modelica.Blocks.Continuous.FirstOrder part(T={tau});", CHAIN),
}


@lru_cache(maxsize=1)
def session(msl: Path) -> Any:
    """Return a session of the compiler that knows the library."""
    import rumoca

    return rumoca.Session(roots=[str(msl / "Modelica"), str(msl / "Complex.mo")])


def modelica_machine(
    parts: str, equations: str, put: dict[str, float], sines: Array, N: int, Ts: float, msl: Path
) -> Any:
    """Return the output of a machine for an input of some size."""
    import rumoca

    wave = " + ".join(f"{a!r}*sin({f!r}*time + {p!r})" for a, f, p in sines.T.tolist())
    text = MODEL.format(parts=parts.format(**put), wave=wave, equations=equations)
    model = session(msl).loads(text, model="M")
    grid = np.arange(N) * Ts
    exact = [rumoca.SimConfig(rtol=r, atol=1e-3 * r, dt=Ts) for r in (1e-7, 1e-6, 1e-5)]

    def run(size: float) -> Array:
        for config in exact:  # the solver does not pass its own checks at every tolerance
            with suppress(rumoca.SimulationError):
                found = model.simulate((0.0, float(grid[-1])), config=config, params={"size": size})
                break
        else:
            return np.full(N, np.nan)
        at = np.searchsorted(np.asarray(found.time), grid - 1e-9 * Ts)  # events add rows
        return np.asarray(found["y"])[at]

    return run


# ---- one machine --------------------------------------------------------------------------------------------------------


def driven(rng: np.random.Generator, N: int, Ts: float, f: float) -> tuple[str, Array]:
    """Return an input within one: a multisine, filtered noise or held levels."""
    kind = ("multisine", "noise", "levels")[rng.integers(3)]
    if kind == "multisine":
        lines = np.arange(1, max(int(1.5 * f * N * Ts), 2))
        chosen = rng.choice(lines, min(30, lines.size), replace=False)
        x = np.cos(2 * np.pi * np.outer(np.arange(N) / N, chosen) + rng.uniform(0, 2 * np.pi, chosen.size)).sum(axis=1)
    elif kind == "noise":
        x = sosfiltfilt(butter(2, 2 * Ts * f * rng.uniform(0.5, 1.5), output="sos"), rng.standard_normal(N))
    else:
        x = np.repeat(rng.uniform(-1, 1, N), rng.integers(int(0.3 / f / Ts), int(1.5 / f / Ts), N))[:N]
    return kind, x / np.abs(x).max()


def machine(kind: str, seed: int, msl: Path | None) -> dict[str, Any]:
    """Return the record of a machine and what is known of it."""
    rng = np.random.default_rng([seed, *map(ord, kind)])
    f, zeta, N = rng.uniform(0.5, 1.5), rng.uniform(0.15, 1.0), int(rng.integers(1500, 3001))
    Ts, w = 0.002 * round(1 / f / rng.uniform(20, 50) / 0.002), 2 * np.pi * f
    a, b = rng.random(2)
    k, c = w**2, 2 * zeta * w
    put = {
        "k": k, "c": c, "w": w, "zeta": zeta, "weak": (0.2 + 0.3 * a) * k, "static": 1 + 0.6 * a, "slow": (0.2 + 0.8 * b) / w,
        "s0": (10 + 40 * b) * k, "s1": w, "limit": 0.5 + a, "tau": (0.2 + a) / w, "third": N * Ts / 3, "late": 0.002 * (1 + int(98 * a)),
        "stiff": (20 + 50 * a) * k,
    }  # fmt: skip
    excitation, u = driven(rng, N, Ts, f)
    accept, way, run = (), 0, None
    if kind in MUJOCO or kind in LINEAR:
        accept, way, slots = MUJOCO[kind] if kind in MUJOCO else ((), 0, LINEAR[kind])
        run = mujoco_machine(slots, put, u, Ts)
    else:
        accept, way, *text = MODELICA[kind] if kind in MODELICA else ((), 0, *LINEAR_MODELICA[kind])
        sines = np.array([rng.uniform(0.3, 1, SINES), w * rng.uniform(0.05, 1.5, SINES), rng.uniform(0, 6.28, SINES)])
        excitation, u = "multisine", sines[0] @ np.sin(np.outer(sines[1], np.arange(N) * Ts) + sines[2][:, None])
        run = modelica_machine(*text, put, sines, N, Ts, msl)
    size, wanted = 1.0, np.exp(rng.uniform(*np.log([0.06, 0.25])))
    if way:
        plain = run(PLAIN[way]) / PLAIN[way]
        low, high = SIZES
        for _ in range(16):
            size = (low * high) ** 0.5
            added = np.std(run(size) / size - plain) / np.std(plain)
            low, high = (size, high) if (added < wanted) == (way > 0) else (low, size)  # what is unstable is none
    clean = run(size)
    noise = rng.uniform(0.005, 0.02) * clean.std() * rng.standard_normal(N)
    return {"accept": accept, "excitation": excitation, "u": size * u, "y": clean + noise, "noise": noise, "Ts": Ts}


def judged(kind: str, seed: int, msl: Path | None) -> dict[str, Any]:
    """Identify and diagnose one machine."""
    warnings.simplefilter("ignore")
    made, begin = machine(kind, seed, msl), perf_counter()
    row = {
        "kind": kind,
        "seed": seed,
        "excitation": made["excitation"],
        "accept": made["accept"],
        "null": not made["accept"],
    }
    record = ns.Record.from_arrays(made["u"], made["y"], made["Ts"], name=kind)
    try:
        found = common.diagnosed(record)
    except Exception as failed:
        return row | {"said": f"{type(failed).__name__}: {failed}", "visible": True, "right": False, "sure": 0.0}
    step = found.steps[0]
    held = step.base.split.held
    floor = float(np.mean(made["noise"][np.concatenate(held)] ** 2))
    left = step.base.mean_square(held)
    first = step.candidates[0] if step.candidates else None
    names = step.verdict != "nothing_detectable"
    return row | {
        "visible": bool(left >= 1.5 * floor), "left": (left / floor) ** 0.5, "verdict": step.verdict,
        "after": ((step.chosen or step.base).mean_square(held) / floor) ** 0.5,
        "right": first is not None and first.effect in made["accept"] if made["accept"] else not names,
        "sure": (first.probability or 0.0) if first and names else 0.0, "said": ", ".join(c.effect for c in step.candidates[:4]), "set": step.confusion_set,
        "seconds": perf_counter() - begin,
    }  # fmt: skip


def main() -> None:
    """Run all machines; print each, and the counts."""
    given = common.asked(__doc__, seed=1, each=2, nulls=2, kinds="", msl=Path)
    hidden = [*MUJOCO, *(MODELICA if given.msl else ())]
    plain = [*LINEAR, *(LINEAR_MODELICA if given.msl else ())]
    cases = [(kind, given.seed + i) for kind in hidden for i in range(given.each)]
    cases += [(kind, given.seed + i) for kind in plain for i in range(given.nulls)]
    counts: Counter[tuple[str, str]] = Counter()
    for kind, seed in cases:
        if given.kinds and kind not in given.kinds.split(";"):
            continue
        r = judged(kind, seed, given.msl)
        group = "nothing hidden" if r["null"] else "one effect"
        seen = r["null"] or r["visible"]
        counts[group, "machines"] += 1
        counts[group, "visible"] += seen
        counts[group, "right, of the visible"] += r["right"] and seen
        counts[group, "in the set, of the visible"] += bool({*r.get("set", ())} & {*r["accept"]}) and seen
        counts[group, f"said with more than {SURE}, and wrong"] += r["sure"] > SURE and not r["right"]
        print(
            f"{common.mark(r['right'], seen):6}{kind:34}{seed:<4}{r['excitation']:10}base {r.get('left', np.nan):6.2f} -> "
            f"{r.get('after', np.nan):5.2f} floors  {r.get('verdict', 'failed'):21}{r['sure']:5.2f}  {r['said']} {r.get('seconds', 0):.0f} s",
            flush=True,
        )
    common.print_counts(counts)


if __name__ == "__main__":
    main()
