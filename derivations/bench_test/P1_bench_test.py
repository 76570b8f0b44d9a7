# %% [markdown]
# # P1: the bench test
# A piezo actuator with Bouc-Wen hysteresis (Rakotondrabe 2011):
# $\dot h = A\dot u - \beta|\dot u|h - \gamma\dot u|h|$, $y = d_p u - h$.
# Runge-Kutta of fourth order, 1 ms. The input is white Gaussian noise through a fifth-order Butterworth
# low-pass filter of 1 Hz, 50 s long. The paper does not print its amplitude: 75 V at the peak is assumed.

# %%
import numpy as np

import narx_sym as ns
from narx_sym import plants, plots

Ts, N = 1e-3, 50_000
t = Ts * np.arange(N)
u = plants.filtered_noise(N, Ts, cutoff=1.0, peak=75.0, seed=0, order=5)
y = plants.bouc_wen(u, Ts, A=0.9, beta=0.008, gamma=0.008, d_p=1.6)
print(r"\dot{h} = A\dot{u} - \beta|\dot{u}|h - \gamma\dot{u}|h|, \qquad y = d_{\rm p}u - h")

# %% [markdown]
# ## Checks of the generator
# The same equations with eight steps per sample; the bound $|h| \le A/(\beta+\gamma)$; the power above 2 Hz.

# %%
fine = 1.6 * u - plants.rk4(
    lambda h, _, du: 0.9 * du - 0.008 * abs(du) * h - 0.008 * du * abs(h), 0.0, u, Ts, substeps=8
)
power = np.abs(np.fft.rfft(u)) ** 2
above = power[np.fft.rfftfreq(N, Ts) > 2].sum() / power.sum()
print(f"integration error {np.abs(y - fine).max():.1e} um, share of power above 2 Hz {above:.1e}")

# %% [markdown]
# ## Without compensation
# The reference in um is applied as a voltage. The paper prints 6.536; this plant gives 6.43, and the figure is
# deterministic. (The paper's `40 sin(2 pi k)` means `40 sin(2 pi t)`.)

# %%
sine = 40 * np.sin(2 * np.pi * t)
loop = plants.bouc_wen(sine, Ts)
uncompensated = ns.mape(sine, loop)
print(f"uncompensated MAPE {uncompensated:.3f} % (paper 6.536)")

# %%
figure, axes = plots.new_axes(figsize=(11, 5))
figure.clear()
grid = figure.add_gridspec(2, 2, width_ratios=(3, 2))
top = figure.add_subplot(grid[0, 0])
bottom = figure.add_subplot(grid[1, 0], sharex=top)
right = figure.add_subplot(grid[:, 1])
top.plot(t, u, color=plots.BLUE, lw=0.9)
top.set(ylabel="u [V]", title="excitation and output")
bottom.plot(t, y, color=plots.BLACK, lw=0.9)
bottom.set(xlabel="time [s]", ylabel="y [um]", xlim=(0, 50))
right.plot(u, y, color=plots.SKY, lw=0.6, label="identification")
right.plot(sine[2000:3001], loop[2000:3001], color=plots.RED, lw=2, label="40 sin(2πt) V, third period")
right.set(xlabel="u [V]", ylabel="y [um]", title="hysteresis")
right.legend(loc="upper left", fontsize=8)
figure

# %%
assert u.shape == y.shape == (N,) and np.isclose(np.abs(u).max(), 75.0)
assert np.abs(y - fine).max() < 1e-4  # of 100 um
assert np.abs(1.6 * u - y).max() < 0.9 / 0.016
assert above < 1e-3
assert abs(uncompensated - 6.43) < 0.01
