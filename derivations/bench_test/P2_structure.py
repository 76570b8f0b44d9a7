# %% [markdown]
# # P2: the structure, by ERR and AIC
# The pool has the products up to degree 3 of $y_{k-1}$, $u$, $\phi_1$, $\phi_2$ that meet Assumption 1 and
# Assumption A1(i): 23 of 119. Two rules of this package leave 19: terms vanish at rest, else the output drifts, and of
# the linear input terms $\phi_{1,k-1}$ alone is kept. The target is $y_k - y_{k-1}$: on $y_k$ itself, $y_{k-1}$ takes all but 1e-5 of the energy.

# %%
import numpy as np

import narx_sym as ns
from narx_sym import assumptions, plants, plots
from narx_sym.fit.bases import select as selection
from narx_sym.symbolic.grammar import parse

k, u, y = ns.k, ns.u, ns.y


def bench(seed):
    volts = plants.filtered_noise(seed=seed, peak=75.0)
    return ns.Record.from_arrays(volts, plants.bouc_wen(volts), Ts=1e-3)


record = bench(0)
pool = ns.pool(n_y=1, n_u=2, degree=3, rules=assumptions.CONTINUUM + assumptions.COMPENSATION)
print(pool)
print(", ".join(ns.text(term) for term in pool))

# %% [markdown]
# ## The direct model
# AIC never turns up on noise-free data. Its knee ends the model: later terms lower it by less than 5 % of what
# the first one did.

# %%
found = selection.select(pool, record, criterion="knee")
for place, (term, err, aic) in enumerate(zip(found.picks, found.path.err, found.path.aic[1:], strict=True), 1):
    mark = " <- knee" if place == found.chosen else ""
    print(f"{place:2d}  {ns.text(term):32s} ERR {err:.2e}  AIC {aic:.0f}{mark}")
print(ns.latex(found.model))

# %% [markdown]
# ## The inverse model
# The pool of Assumption 1 only, with $y_{k-1}$ standing for the measured $y_{k+1}$ ($\tau_s = 2$).

# %%
inverse_pool = ns.pool(inverse=True, n_y=1, n_u=1, rules=assumptions.CONTINUUM)
frame = ns.NARX([u[k - 1]], output=u, input=y, lead=2)
inverse = selection.select(inverse_pool, record, criterion="knee", frame=frame)
print(inverse_pool)
for place, (term, err) in enumerate(zip(inverse.picks, inverse.path.err, strict=True), 1):
    print(f"{place:2d}  {ns.text(term):42s} ERR {err:.2e}{' <- knee' if place == inverse.chosen else ''}")
print(ns.latex(inverse.model))

# %% [markdown]
# ## How often
# Ten noise seeds, and all ten records at once. Picks four and five of the inverse depend on the seed: most have the
# paper's $\breve\phi_2 y u$ and $\breve\phi_2 y^2$, this one has the same two with $\breve\phi_1$ in the place of
# $\breve\phi_2$, because the two kinds resemble each other on such data (correlation below).
# The plant is rate-independent, and so are terms with a factor $\phi_1$. The paper's two are not: without that
# factor a term acts per sample. Their $\theta_5, \theta_6 \approx 10^{-5}$ say how little they do at 1 kHz.

# %%
PAPER = [parse(text) for text in (
    "phi1[k-1]", "phi2[k-2]*phi1[k-2]*u[k-2]", "phi2[k-2]*phi1[k-2]*y[k-1]",
    "phi1[k-2]*u[k-2]**2", "phi1[k-2]*u[k-2]*y[k-1]",
)]  # fmt: skip
PAPER_INVERSE = [parse(text) for text in (
    "breve_phi1[k-1]", "breve_phi2[k-1]*breve_phi1[k-1]*u[k-1]", "breve_phi2[k-1]*breve_phi1[k-1]*y[k-1]",
    "breve_phi2[k-1]*y[k-1]*u[k-1]", "breve_phi2[k-1]*y[k-1]**2",
)]  # fmt: skip
candidates, target, _ = selection.candidates_of(pool, True, y)
inverse_candidates, inverse_target, _ = selection.candidates_of(inverse_pool, True, u)
direct_frame = ns.NARX([y[k - 1]])


def five(frame, candidates, target, records):
    path = selection.path_of(frame, candidates, target, records, 5)
    return [candidates[i] for i in path.order]


records = [bench(seed) for seed in range(10)]
direct_picks = [five(direct_frame, candidates, target, one) for one in records]
inverse_picks = [five(frame, inverse_candidates, inverse_target, one) for one in records]
together = five(direct_frame, candidates, target, records)
inverse_together = five(frame, inverse_candidates, inverse_target, records)
hits = sum(set(picks) == set(PAPER) for picks in direct_picks)
inverse_hits = sum(set(picks) == set(PAPER_INVERSE) for picks in inverse_picks)
print(f"the paper's structure: direct {hits} of 10, inverse {inverse_hits} of 10")
print("inverse, all ten together:", ", ".join(map(ns.text, inverse_together)))
for seed, picks in enumerate(inverse_picks):
    print(f"seed {seed}, inverse picks 4 and 5:", ", ".join(map(ns.text, picks[3:])))
step, twist = np.diff(record.y[1:]), record.u[1:-1] * record.y[2:]
alike = np.corrcoef(step * twist, np.sign(step) * twist)[0, 1]
print(f"correlation of phi1*u*y and phi2*u*y: {alike:.2f}")

# %%
figure, axes = plots.new_axes(1, 2, figsize=(12, 5))
for ax, result, name in zip(axes, (found, inverse), ("direct model", "inverse model"), strict=True):
    place = np.arange(len(result.path.aic))
    ax.plot(place, result.path.aic / 1000, color=plots.BLUE, marker="o", ms=5, lw=1.2)
    ax.plot(result.chosen, result.path.aic[result.chosen] / 1000, color=plots.RED, marker="o", ms=13, mfc="none",
            ls="none", mew=2, label="knee")  # fmt: skip
    ax.set_xticks(place, ["none", *(f"${ns.latex(term)}$" for term in result.picks)], rotation=55, ha="right",
                  rotation_mode="anchor", fontsize=9)  # fmt: skip
    ax.set(title=name, xlabel="term added")
    ax.legend(loc="upper right", fontsize=9)
axes[0].set_ylabel("AIC / 1000")
figure

# %%
assert len(pool) == 19
assert found.chosen == 5 and found.picks[:5] == PAPER  # in the paper's order
assert hits >= 7 and set(together) == set(PAPER)
assert inverse_hits >= 5 and set(inverse_together) == set(PAPER_INVERSE)
assert alike > 0.7
assert inverse.chosen == 5
assert all(set(picks[:3]) == set(PAPER_INVERSE[:3]) for picks in inverse_picks)
