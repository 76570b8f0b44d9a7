"""What a record says before any model, against simulated plants: feedback, valves, noise.

    python tests/bench/evidence.py --part feedback|valves|imitated|noise [--seed 0] [--plants 25]

Plants of first and second order and resonant ones, with time constants of 1 to 30 samples; noise of 1 % on the output.
Nothing here comes from the package but what is asked.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
from common import asked, diagnosed
from scipy.signal import butter, lfilter

from narx_sym.data.evidence.feedback import feedback
from narx_sym.data.evidence.noise import repeated, sensor_noise
from narx_sym.data.evidence.stiction import sticking
from narx_sym.data.record import Record

Array = np.ndarray
N, TS = 2000, 0.1
INPUTS = ("steps", "two levels", "noise", "multisine")


def driven(kind: str, rng: np.random.Generator, n: int = N) -> Array:
    """Return an input: random steps, two levels, coloured noise, or a multisine below a tenth of the sampling rate."""
    if kind == "noise":
        return lfilter([1], [1, -rng.uniform(0, 0.9)], rng.standard_normal(n))
    if kind == "multisine":
        lines = np.arange(1, int(rng.integers(n // 100, n // 10)))
        waves = np.sin(2 * np.pi * np.outer(np.arange(n), lines) / n + rng.uniform(0, 6.28, lines.size))
        return waves.sum(axis=1) / np.sqrt(lines.size)
    hold = int(rng.integers(3, 40))
    count = n // hold + 1
    levels = rng.choice([-1.0, 1.0], count) if kind == "two levels" else rng.uniform(-1, 1, count)
    return np.repeat(levels, hold)[:n]


def plant(rng: np.random.Generator) -> tuple[str, Array, Array]:
    """Return the name of a plant, its numerator and its denominator."""
    slow = [np.exp(-1 / tau) for tau in np.exp(rng.uniform(0, np.log(30), 2))]
    kind = ("first order", "second order", "resonant")[rng.integers(3)]
    if kind == "resonant":
        frequency, damping = rng.uniform(0.1, 0.8), rng.uniform(0.2, 0.8)
        pole = np.exp((-damping + 1j * np.sqrt(1 - damping**2)) * frequency)
        denominator = np.real(np.poly([pole, np.conj(pole)]))
        return kind, denominator.sum() * np.array([0.6, 0.4]), denominator
    denominator = np.real(np.poly(slow[: 1 + (kind == "second order")]))
    return kind, np.array([denominator.sum()]), denominator


def delayed(u: Array, d: int, rng: np.random.Generator, noise: float = 0.01) -> tuple[str, Record]:
    """Return a record of a random plant with a dead time of d samples."""
    kind, numerator, denominator = plant(rng)
    y = lfilter(numerator, denominator, np.concatenate([np.zeros(d), u[: u.size - d]]))
    return kind, Record.from_arrays(u, y + noise * np.std(y) * rng.standard_normal(u.size), Ts=TS)


def loop(rng: np.random.Generator, n: int = N) -> tuple[str, Record]:
    """Return a healthy linear process under PI or PID control: setpoint steps, load disturbances, or both."""
    tau, gain, dead = np.exp(rng.uniform(np.log(3), np.log(40))), rng.uniform(0.5, 3), int(rng.integers(1, 5))
    slow, fast = np.exp(-1 / tau), np.exp(-1 / rng.uniform(1, 10)) if rng.random() < 0.4 else 0.0
    proportional = rng.uniform(0.2, 0.8) * tau / (dead + 2) / gain / 1.5
    reset, rate, late = tau * rng.uniform(0.8, 2), rng.choice([0, 0, 1]) * dead * 0.3, int(rng.random() < 0.3)
    kind, noise = str(rng.choice(["steps", "load", "both"])), rng.choice([0.003, 0.01, 0.03])
    wanted = np.zeros(n) if kind == "load" else np.repeat(rng.uniform(-1, 1, n // 200 + 1), 200)[:n]
    load = lfilter([0.05], [1, -0.97], rng.standard_normal(n)) * rng.uniform(0.5, 2)
    if kind != "load":
        load = np.repeat(rng.uniform(-0.3, 0.3, n // 150 + 1), 150)[:n] if kind == "both" else np.zeros(n)
    u, y, seen = np.zeros(n), np.zeros(n), np.zeros(n)
    first = second = total = before = 0.0
    for k in range(n):
        if k > 0:
            first = slow * first + (1 - slow) * gain * ((u[k - dead] if k >= dead else 0.0) + load[k])
            second = fast * second + (1 - fast) * first
        y[k] = second + noise * rng.standard_normal()
        seen[k] = y[k - late] if k >= late else 0.0
        error = wanted[k] - seen[k]
        total += error / reset
        u[k] = proportional * (error + total + rate * (error - before))
        before = error
    return f"{kind}, noise {noise}", Record.from_arrays(u, y, Ts=TS, channels={"setpoint": wanted})


def dampers(seed: int, count: int) -> int:
    """Return how many open records of dampers are taken for closed loops: viscous and dry forces on a random movement."""
    rng, found = np.random.default_rng(seed), 0
    for _ in range(count):
        moved = lfilter(*butter(2, np.exp(rng.uniform(np.log(0.01), np.log(0.4)))), rng.standard_normal(1500))
        moved /= np.std(moved)
        speed = np.diff(moved, prepend=0)
        speed /= np.std(speed)
        dry = rng.uniform(0, 1.5) * np.tanh(rng.uniform(2, 20) * speed)
        force = rng.uniform(0, 1) * speed + dry + rng.choice([0.0, 0.3, 1.0]) * moved
        noise = rng.choice([0.002, 0.01]) * np.std(force) * rng.standard_normal(force.size)
        found += feedback(Record.from_arrays(moved, force + noise, Ts=0.01)).found
    return found


def loops(seed: int, plants: int) -> None:
    """Count the healthy loops that are recognised, without and with the setpoint, and open loops that are not."""
    rng = np.random.default_rng(seed)
    seen: Counter[str] = Counter()
    for i in range(plants):
        kind, record = loop(rng)
        bare = feedback(Record(record.u, record.y, record.t, record.Ts))
        seen["closed loops"] += 1
        seen["closed loops found"] += bare.found
        seen["closed loops found with the setpoint"] += feedback(record).found
        if not bare.found:
            print(f"not found: {kind}, {bare}", flush=True)
        source = INPUTS[i % 4]
        kind, record = delayed(driven(source, rng), int(rng.integers(0, 4)), rng, rng.choice([0.0, 0.003, 0.03]))
        if i % 3 == 2:
            held = np.zeros(len(record))
            for k in range(1, held.size):
                held[k] = min(max(held[k - 1], record.y[k] - 0.2), record.y[k] + 0.2)
            record = Record(record.u, held, record.t, record.Ts)
        found = feedback(record)
        seen["open loops"] += 1
        seen["open loops taken for closed"] += found.found
        if found.found:
            print(f"false: {source}, {kind}, {found}", flush=True)
    seen["dampers read backwards"], seen["taken for closed"] = 5 * plants, dampers(seed, 5 * plants)
    for name, count in seen.items():
        print(f"| {name} | {count} |")


def valve_loop(rng: np.random.Generator, stiction: float, jump: float, n: int = 800) -> Record:
    """Return a loop around a valve that sticks (Choudhury et al. 2005: S and J, in % of span); OP and PV in %.

    Flow loops and levels under PI control, with setpoint steps and a load that wanders.
    """
    level = rng.random() < 0.4
    slow, gain = np.exp(-1 / np.exp(rng.uniform(0.5, 2.5))), rng.uniform(0.7, 1.5)
    dead, reset = int(rng.integers(1, 3)), rng.uniform(10, 40)
    proportional = rng.uniform(0.3, 0.8) * (4.0 if level else 0.5)
    wanted = 50 + np.repeat(rng.uniform(-6, 6, n // 200 + 1), 200)[:n]
    load = lfilter([0.02], [1, -0.99], rng.standard_normal(n)) * (2.0 if level else 5.0)
    noise = rng.choice([0.05, 0.2])
    u, y, x = np.full(n, 50.0), np.full(n, 50.0), np.full(n, 50.0)
    state, total, moving, last = 0.0, 0.0, 0.0, 50.0
    for k in range(1, n):
        drive = x[k - dead] - 50 + load[k] if k >= dead else 0.0
        state = state + 0.02 * gain * drive if level else slow * state + (1 - slow) * gain * drive
        y[k] = 50 + state + noise * rng.standard_normal()
        error = wanted[k] - y[k]
        total += error / (4 * reset if level else reset)
        u[k] = np.clip(50 + proportional * (error + total), 0, 100)
        x[k] = x[k - 1]
        step = u[k] - last
        if moving and step * moving >= 0:
            x[k] = u[k] - moving * (stiction - jump) / 2
        elif abs(u[k] - x[k - 1]) > (stiction + jump) / 2:  # it breaks away
            moving = float(np.sign(u[k] - x[k - 1]))
            x[k] = u[k] - moving * (stiction - jump) / 2
        else:
            moving = 0.0
        last = u[k]
    return Record.from_arrays(u, y, Ts=10.0, channels={"setpoint": wanted})


def valves(seed: int, plants: int) -> None:
    """Count the valves that are judged rightly: in order (band below 0.5 % of span), or sticking (2 to 6 %)."""
    rng = np.random.default_rng(seed)
    right: Counter[bool] = Counter()
    for i in range(plants):
        bad = bool(i % 2)
        stiction = rng.uniform(2, 6) if bad else rng.uniform(0, 0.5)
        record = valve_loop(rng, stiction, rng.uniform(0, 1) * stiction)
        found = sticking(record)
        right[bad] += found.found == bad
        if found.found != bad:
            print(f"S = {stiction:.2f} %: {found.sentence}", flush=True)
    good, bad_ones = plants - plants // 2, plants // 2
    print(f"| in order | {right[False]} of {good} |")
    print(f"| sticking | {right[True]} of {bad_ones} |")
    print(f"| balanced accuracy | {(right[False] / good + right[True] / bad_ones) / 2:.2f} |")


def imitated(seed: int, plants: int) -> None:
    """Say how little of the squared error an effect leaves that only imitates what a healthy loop makes."""
    rng, shares = np.random.default_rng(seed), []
    for _ in range(plants):
        kind, record = loop(rng)
        if not feedback(record).moved_by_setpoint:
            continue
        bare = Record(record.u, record.y, record.t, record.Ts)
        with patch("narx_sym.diagnosis.procedure.closed_loop", lambda records: None):
            found = diagnosed(bare)
        least = {n: min((r.held for r in found.hypotheses if len(r.ids) == n), default=np.inf) for n in (0, 1)}
        left = min(1.0, least[1] / least[0])
        shares.append(left)
        print(f"{kind}: {found.verdict}, {' and '.join(found.confusion_set[:3])}: {100 * left:.0f} % left", flush=True)
    print(f"| healthy loops that their setpoint moves | {len(shares)} of {plants} |")
    print(f"| least of the squared error that an effect leaves | {100 * min(shares, default=1.0):.0f} % |")


def servo(rng: np.random.Generator, friction: float, n: int = 4000) -> Record:
    """Return a mass under position control, without and with dry friction (a share of the controller's rms force)."""
    t, pace, fine = 0.005 * np.arange(n), 0.005, 10
    waves = zip(rng.uniform(0.02, 0.1, 4), rng.uniform(0.2, 2, 4), rng.uniform(0, 6, 4), strict=True)
    wanted = sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in waves)
    mass, drag = rng.uniform(1, 5), rng.uniform(5, 20)
    stiff = 0.3 * mass * rng.uniform(20, 40) ** 2
    damp = 1.4 * np.sqrt(stiff * mass) - drag
    u, y, force = np.zeros(n), np.zeros(n), 0.0
    for held in (0.0, friction):  # the controller's force without friction is the measure
        position = speed = 0.0
        for k in range(n):
            y[k] = position + 1e-5 * rng.standard_normal()
            u[k] = stiff * (wanted[k] - y[k]) - damp * ((y[k] - y[k - 1]) / pace if k else 0.0)
            for _ in range(fine):
                free = speed + pace / fine * (u[k] - drag * speed) / mass
                speed = np.sign(free) * max(abs(free) - pace / fine * held * force / mass, 0.0)
                position += pace / fine * speed
        force = float(np.std(u))
    return Record.from_arrays(u, y, Ts=pace, channels={"setpoint": wanted})


def sines(t: Array, rng: np.random.Generator, slowest: float) -> Array:
    """Return three sines that repeat exactly after `slowest` [s], of peak 1 about."""
    lines = (1, int(rng.integers(2, 5)), int(rng.integers(5, 9)))
    return sum(np.sin(2 * np.pi * n * t / slowest + rng.uniform(0, 6.28)) / n**0.5 for n in lines) / 2


def stepped(n: int, rng: np.random.Generator, hold: int) -> Array:
    """Return levels between -1 and 1, each held for a while."""
    return np.repeat(rng.uniform(-1, 1, n // hold + 1), hold)[:n]


def piezo(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a stage with Bouc-Wen hysteresis, a lightly damped resonance at 200 Hz and logarithmic creep, at 2 kHz."""
    n, fine = 4000, 8
    h = 5e-4 / fine
    t = h * np.arange(n * fine)
    u = sines(t, rng, 0.5)
    memory, x, v = 0.0, 0.0, 0.0
    beta, gamma, w, zeta = rng.uniform(1, 3), rng.uniform(-1, 1), 2 * np.pi * 200, rng.uniform(0.01, 0.05)
    y = np.zeros(u.size)
    for i in range(1, u.size):
        du = u[i] - u[i - 1]
        memory += 0.5 * du - beta * abs(du) * memory - gamma * du * abs(memory)
        v += h * (w * w * (u[i] - 0.4 * memory - x) - 2 * zeta * w * v)
        x += h * v
        y[i] = x
    slow = np.mean([lfilter([1 - s], [1, -s], y) for s in np.exp(-h / np.array([0.05, 0.3, 1.5]))], axis=0)
    return h * fine, u[::fine], (y + rng.uniform(0.1, 0.3) * slow)[::fine]


def valve(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return the flow behind a valve that sticks and jumps (Kano et al. 2004), command in random steps or ramps."""
    n = 4000
    u = 50 + 20 * (stepped(n, rng, 60) if rng.random() < 0.5 else sines(np.arange(n), rng, 1000))
    slack, jump = rng.uniform(2, 6), rng.uniform(0.5, 2)
    stem, moved = u[0], np.zeros(n)
    for i in range(n):
        if abs(u[i] - stem) > slack / 2 + jump / 2:
            stem = u[i] - np.sign(u[i] - stem) * (slack - jump) / 2
        moved[i] = stem
    pole = rng.uniform(0.7, 0.95)
    return 1.0, u, lfilter([1 - pole], [1, -pole], moved - u[0])


def loaded(rng: np.random.Generator, load: Array) -> tuple[float, Array, Array]:
    """Return a lag of second order under a load that enters as its input does."""
    u = sines(np.arange(load.size) * TS, rng, 50.0) if rng.random() < 0.5 else stepped(load.size, rng, 40)
    first, second = rng.uniform(0.7, 0.95), rng.uniform(0.2, 0.7)
    return TS, u, lfilter([1 - second], [1, -second], lfilter([0, 1 - first], [1, -first], u + load))


def coloured_load(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a lag under a load that wanders: 10 to 30 % of the input, correlated over 20 to 100 samples."""
    pole = np.exp(-1 / rng.uniform(20, 100))
    load = lfilter([np.sqrt(1 - pole**2)], [1, -pole], rng.standard_normal(4000))
    return loaded(rng, rng.uniform(0.1, 0.3) * load)


def step_load(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a lag under a load that comes once and stays."""
    load = np.zeros(4000)
    load[int(rng.integers(500, 3500)) :] = rng.choice([-1, 1]) * rng.uniform(0.1, 0.5)
    return loaded(rng, load)


def hidden_temperature(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a lag whose output a room moves slowly."""
    pace, u, y = loaded(rng, np.zeros(4000))
    return pace, u, y + 0.3 * sines(np.arange(4000) * pace, rng, rng.uniform(150, 400))


def motor(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return a position under a periodic current with dry friction: its periods drift."""
    n, fine = 4000, 8
    pace = 0.01
    u = sines(np.arange(n) * pace, rng, 4.0)
    dry, drag, bias = rng.uniform(0.05, 0.2), rng.uniform(0.5, 3), rng.uniform(-0.05, 0.05)
    x = v = 0.0
    y = np.zeros(n)
    for i in range(1, n):
        for _ in range(fine):
            free = v + pace / fine * (u[i - 1] + bias - drag * v)
            v = np.sign(free) * max(abs(free) - pace / fine * dry, 0.0)
            x += pace / fine * v
        y[i] = x
    return pace, u, y


PLANTS = (piezo, valve, coloured_load, step_load, hidden_temperature, motor)


def noise(seed: int, plants: int) -> None:
    """Compare the stated noise of the sensor with the true one, at 0.1 to 2 % of the output."""
    every = []
    for made in PLANTS:
        ratios = []
        for i in range(plants):
            rng = np.random.default_rng([seed, i])
            pace, u, clean = made(rng)
            size = np.std(clean) * 10 ** rng.uniform(-3, np.log10(0.02))
            record = Record.from_arrays(u, clean + size * rng.standard_normal(clean.size), Ts=pace)
            ratios.append(sensor_noise([record], repeated(record)) / size)
        right = sum(0.7 <= r <= 1.5 for r in ratios)
        every += ratios
        name = made.__name__.replace("_", " ")
        print(f"| {name} | {right} of {plants} | {min(ratios):.2f} ... {np.median(ratios):.2f} ... {max(ratios):.2f} |")
    print(f"| all | {sum(0.7 <= r <= 1.5 for r in every)} of {len(every)} | |")


PARTS: dict[str, Callable[[int, int], Any]] = {
    "feedback": loops,
    "valves": valves,
    "imitated": imitated,
    "noise": noise,
}


def main() -> int:
    """Run one part."""
    options = asked(__doc__, part="feedback", seed=0, plants=25)
    PARTS[options.part](options.seed, options.plants)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
