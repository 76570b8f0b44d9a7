# %% [markdown]
# # How a record becomes a law
# One record and one theta, walked through the code. Nothing here is written from memory: while each step runs, Python
# tells which functions of the package are entered, and the page lists their modules in the order of their first call.

# %%
import importlib
import pkgutil
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

import narx_sym as ns
from narx_sym import plants

PACKAGE = str(Path(ns.__file__).parent)
volts = plants.filtered_noise(N=4000, Ts=0.01, cutoff=0.5, peak=75.0, seed=5)
measured = plants.bouc_wen(volts, Ts=0.01)
TERMS = [
    "y[k-1]", "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
]  # fmt: skip
ROOMS = "errors symbolic models files inversion engines codegen data fit diagnosis report app cli".split()
for room in ROOMS[1:9]:  # what is imported on the way would look like a visit
    for found in pkgutil.iter_modules(importlib.import_module(f"narx_sym.{room}").__path__):
        importlib.import_module(f"narx_sym.{room}.{found.name}")
visited = {}


@contextmanager
def watched(step):
    """Note the modules of the package whose functions are entered, in order."""
    seen = visited[step] = {}

    def note(frame, event, argument):
        where = frame.f_code.co_filename
        if event == "call" and where.startswith(PACKAGE) and not frame.f_code.co_name.startswith("<"):
            module = where[len(PACKAGE) + 1 : -3]
            seen.setdefault(module, frame.f_code.co_name)

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)
    table = Table("module", "first function entered there", title=step)
    for module, function in seen.items():
        table.add_row(module.replace("/__init__", ""), function)
    Console().print(table)


# %% [markdown]
# ## Arrays become a `Record`
# Equal lengths, finite values, one sampling time; what was odd is in `record.notes`.

# %%
with watched("Record.from_arrays"):
    record = ns.Record.from_arrays(volts, measured, Ts=0.01)
print(record)

# %% [markdown]
# ## Texts become a `Model`
# The grammar reads the terms, the assumptions are checked, the parameters get their symbols. No number yet.

# %%
with watched("NARX.from_terms"):
    model = ns.NARX.from_terms(TERMS)
print(ns.latex(model))

# %% [markdown]
# ## The constraint is derived
# All signals held constant, what remains must hold for every rest: Sigma_y = 1.

# %%
with watched("analysis.continuum_conditions"):
    conditions = ns.analysis.continuum_conditions(model)
print(*map(ns.latex, conditions))

# %% [markdown]
# ## The fit gives theta
# `fit` returns the fitted model. The regressors are compiled, one QR factor of the streamed rows is kept, and the
# constraint is eliminated. Follow one number, that of $\theta_2$:

# %%
with watched("Model.fit"):
    fitted = model.fit(record, constraints=["continuum"])
theta_2 = float(fitted.theta[1])
print(f"{fitted.symbols[1]} = {theta_2:.6f}, the factor of {ns.text(fitted.terms[1])}")

# %% [markdown]
# ## The model runs freely
# The recursion is planned, compiled to machine code, and run from where the record starts.

# %%
with watched("Model.simulate"):
    free = fitted.simulate(record.u, y0=record.y[0])
print(f"free-run error: {ns.mape(record.y, free):.2f} % of the range")

# %% [markdown]
# ## The model becomes a law
# Symbols again: the newest input is isolated, u becomes m, y becomes r. $\theta_2$ is now a divisor.

# %%
with watched("Model.compensator"):
    law = fitted.compensator()
print(ns.latex(law))

# %% [markdown]
# ## The law runs over a reference
# The same engines; then the check whether the law repels where it went.

# %%
reference = 30 * np.sin(2 * np.pi * 0.2 * record.Ts * np.arange(2000))
with watched("Compensator.run"):
    m = law.run(reference, m0=0.0)
print(f"tracking error on the plant: {ns.mape(reference, plants.bouc_wen(m, Ts=0.01)):.2f} % of the range")

# %% [markdown]
# ## The law leaves
# C has numbers only: the factor of the newest reference is $1/\theta_2$.

# %%
with watched("Compensator.export"):
    source = law.export("c")
factor = repr(1 / theta_2)[:10]
print(factor, "stands in", next(line for line in source.splitlines() if factor in line))

# %% [markdown]
# How the same recursion carries a physical effect that was added, its slopes and its inverse:
# [](../guides/law_on_a_plc.py). Where to put something new: [](places_to_touch.md).

# %%
rooms = {step: {module.split("/")[0] for module in seen} for step, seen in visited.items()}
assert set().union(*rooms.values()) <= set(ROOMS)
assert rooms["analysis.continuum_conditions"] <= {"symbolic", "models"}  # no numbers
assert {"fit", "engines"} <= rooms["Model.fit"] and {"engines"} <= rooms["Model.simulate"]
assert "inversion" in rooms["Model.compensator"] and "codegen" in rooms["Compensator.export"]
assert not {"diagnosis", "report", "app", "cli"} & set().union(*rooms.values())
assert factor in source
