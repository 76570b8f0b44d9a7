# %% [markdown]
# # An effect of your own, in ten lines
# An effect is a function that returns its equation. `x` is the driving signal; the other arguments are shape
# parameters with start values. Everything else is derived from it: the equations at each place, the derivatives, the
# fit, the inverse.

# %%
import tempfile
from pathlib import Path

import numpy as np
import sympy as sp

import narx_sym as ns
from narx_sym import k, plants


@ns.effect("input", scan={"s": ns.Scan("amplitude", (0.2, 0.5, 1.0), unit="V")}, source="our notebook, 2026")
def soft_start(x, s):
    """The amplifier gives less around zero."""
    return -x[k] * sp.exp(-((x[k] / s) ** 2))


# %% [markdown]
# ## Is it found?
# Here is a machine with that amplifier, simulated independently of the effect's code, with 0.5 % noise.

# %%
volts = plants.filtered_noise(N=4000, Ts=0.01, cutoff=0.5, peak=10.0, seed=3)
driven = volts * (1 - 0.6 * np.exp(-((volts / 3.0) ** 2)))
position = np.zeros(volts.size)
for i in range(1, volts.size):
    position[i] = 0.9 * position[i - 1] + 0.2 * driven[i - 1]
noise = 0.005 * position.std() * np.random.default_rng(0).standard_normal(position.size)
record = ns.Record.from_arrays(volts, position + noise, Ts=0.01)
linear = ns.identify(record, base="linear")
found = ns.diagnose(linear, record)  # the whole catalogue, yours in it
print(found.sentence({"u": "V"}))
print(found.verdict, found.confusion_set)

# %%
better = linear.add(found.best).fit(record)
print(ns.latex(better))
shape = dict(zip(map(str, better.symbols), better.theta, strict=True))["s_soft_start"]
print(f"s = {shape:.3f} V, simulated with 3 V")

# %% [markdown]
# `@effect(..., never="thermal tank")` excludes kinds of machines, `only="pendulum"` restricts the effect to one, and
# `means={"thermal": "a loss"}` gives its name there; `narx_sym.effects.MACHINES` lists the kinds.
#
# ## The same as text
# A text file can contain effects, for `--effects mine.toml`. It is parsed by a grammar and never executed.

# %%
MINE = """
[[effect]]
id = "soft_start"
where = "input"
driver = "u"
z = "-x[k]*exp(-(x[k]/s)**2)"
scan = { s = { of = "amplitude", values = [0.2, 0.5, 1.0] } }
sentence = "The amplifier gives less around zero."
unit = { s = "V" }
source = "our notebook, 2026"
"""
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "mine.toml"
    path.write_text(MINE)
    (read,) = ns.load_effects(path, ns.effects.Catalogue())
print(read.id, read.shape)

# %% [markdown]
# To add one to the catalogue for everybody: [](../inside/places_to_touch.md).

# %%
ns.EFFECTS.pop("soft_start")  # the other pages have the catalogue as it was
assert found.best.effect == "soft_start"
assert abs(shape / 3 - 1) < 0.1
assert read.id == "soft_start" and read.shape == ("s",)
