"""Simulated measurements to begin with: a piezo actuator with hysteresis, and a stage behind a gear with play."""

from __future__ import annotations

import numpy as np

from . import plants
from .record import Record

ACTUATOR_UNITS = {"u": "V", "y": "um", "r": "um", "m": "V"}
PEAK, SEED = 75.0, 0
STAGE_UNITS = {"u": "rad", "y": "mm"}
PLAY, TS, SAMPLES = 0.3, 0.01, 2000  # half-width of the gear's play [rad]; sampling time of the stage [s]


def actuator(seed: int = SEED, peak: float = PEAK) -> tuple[Record, Record]:
    """Return identification and validation records of the piezo actuator (section 5 of the paper)."""
    u = plants.filtered_noise(peak=peak, seed=seed)
    t = np.arange(u.size) * 1e-3
    sine = 40 * np.sin(2 * np.pi * t)
    return (
        Record.from_arrays(u, plants.bouc_wen(u), Ts=1e-3, name="identification"),
        Record.from_arrays(sine, plants.bouc_wen(sine), Ts=1e-3, name="validation"),
    )


def stage(play: float, seed: int = SEED) -> Record:
    """Return a record of a motor that moves a stage through a gear with play, by an elastic spindle.

    The gear follows the motor's angle once the slack is taken up; the stage obeys x'' + 2 d w x' + w^2 x = w^2 g p.
    Integrated in small steps, with the noise of a position sensor.

    Parameters
    ----------
    play : float
        Half of the slack [rad].
    """
    w, d, gain, noise, fine = 2 * np.pi * 3.0, 0.5, 0.8, 0.02, 20  # [rad/s], -, [mm/rad], [mm], steps per sample
    u = plants.filtered_noise(N=SAMPLES, Ts=TS, cutoff=2.0, peak=5.0, seed=seed + 1)
    h, p, x, v = TS / fine, float(u[0]), 0.0, 0.0
    path = []
    for angle in u.tolist():
        path.append(x)
        p = max(angle - play, min(angle + play, p))
        for _ in range(fine):
            v += h * (w * w * (gain * p - x) - 2 * d * w * v)
            x += h * v
    y = np.array(path) + noise * np.random.default_rng(seed + 2).standard_normal(u.size)
    return Record.from_arrays(u, y, Ts=TS, name="stage")
