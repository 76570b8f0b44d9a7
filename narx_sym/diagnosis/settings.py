"""Every number that a diagnosis decides by: what it is, and where it comes from.

Shares and prices are without a unit; a price is a difference of ln(mean square). `tests/bench/sensitivity.py` varies
those of the verdict over the measured records.
"""

from __future__ import annotations

import numpy as np

from ..fit.bases.choice import PRICE

# ---- the price and the verdict -----------------------------------------------------------------------------------
PER_PARAMETER = PRICE  # that of bases; half and twice of it name the same measured machines
PER_EFFECT = 0.27  # of 25 that a linear base may lack one is picked: ln 25 / 12 blocks (extended BIC, Chen & Chen 2008)
OF_FEW = float(np.log(2) / np.log(25))  # of that, where of two that only filter one is picked beside another effect
ENOUGH = 0.9  # fewer effects win if they remove this share of the rms error that more of them remove
ALIKE = 0.1  # difference of log errors, or of prices, that counts as none, whatever its standard error: 5 % rms
SAME = 0.01  # difference of the log errors of one free run under two names: half a percent rms
HELPS = 0.3  # share of the removable error: what removes less, or a base's structure below it, explains nothing
LEFT = 0.1  # of the winner's error follows from the signals, and rms beside what it removes: more, and it is not all
LARGE = 0.25  # share of the held-out error: what removes more is no accident of the noise
TEMPERATURE = 1.0  # of probabilities: the likelihood as it is (derivations/results/named.md has the reliability)
LEVEL, POWER = 0.05, 0.8416  # of the test for structure; standard normal quantile of 80 %
DRAWS = 999  # of a randomisation test, and of the bootstrap of an interval
FEWEST = 100  # samples: with less the noise cannot be told from an effect
ROUNDING = 1e-9  # of a signal's standard deviation or range: what is up to here is arithmetic
SMALL = {"um": 1.1}  # a stage that is told in mm need be no piezo: at most so many of this unit

# ---- the split -----------------------------------------------------------------------------------------------------
BLOCKS, FOLDS = 12, 4  # of a record, judged by fits to the others; 2 BLOCKS where the last part is sealed
SEALED = 3  # of 2 BLOCKS, at the end: the last eighth

# ---- screening -----------------------------------------------------------------------------------------------------
TRIED = 10  # effects that are fitted, of all: by what their directions explain, half as many by likelihood
FORMS_TRIED, HALF = 2, 0.5  # forms of each beside another effect, that explain half of its best
COLUMNS, OFFERED = 12, 6  # that the noise is freed of at most, and that are tried for each
CLEAR = 18.0  # gain of each at least [variances]
LONGEST = 120  # lags of the noise model at most
CYCLES = 8  # of a periodic disturbance at least: fewer are a wander
BELOW = 4.0  # how far a shape parameter may leave its grid downwards
PADDING, LINE = 4, 6.0  # zero padding of spectra; a line is this many times (and the log of their number) above noise
FEATURES, SOME = 60, 0.4  # random cosines of the black box, and the share of the signals that each looks at
BUMPS = 0.7  # wave numbers of the cosines, over the standard deviations of the signals
PENALTIES = np.logspace(-6, 1, 15)  # of its ridge regression, times the largest eigenvalue
POLES = (0.8, 0.97)  # of slow versions of the signals
FEW, ROWS = 6, 8000  # columns of a sparse solution, and rows that it looks at

# ---- the search ----------------------------------------------------------------------------------------------------
TOGETHER = 6  # effects that are fitted closer, of all that were looked at, and that are shown
PARTNERS = 2  # of them, how many may be half of a pair
RIVALS = 3  # that are named, of a pair and of what comes nearest, and that are tried in place of an earlier effect
LOOKS = 3  # shapes from which a fit is begun
HIGHER = (5, 7, 9, 11)  # orders of further cores, tried in turn
REFUSALS = 4  # after so many terms that must stay, no others are tried
SLACK, RETURNED = 1.01, 0.001  # growth of the error, or share of what the effect removed, for which a term goes

# ---- fits ----------------------------------------------------------------------------------------------------------
LOOK, NEAR, FIRST, CLOSER = 3, 8, 15, 16  # steps of a look at a hypothesis, near another, of a core alone, and closer
STEPS: int = 40  # of a fit to the end
FINAL = 200  # of the last fit: a kink is passed slowly
BRIEF, TOLERANCE = 1e-3, 1e-7  # relative gain of a step at which a brief fit ends, and the last one
GAIN: float = 1e-5  # and a usual one
TRIALS, RIDGE = 5, 1e-12  # dampings of a step of Levenberg and Marquardt, and the least of them
TURNS = 4  # of what is improved in turn: least squares and filters, base and offsets, size and doubt
UNSEEN = 0.03  # share of a derivative on the rows that count
FULL = 1.1  # a full effect with the uncertainty of its coefficient
MOVES = 0.999  # of its force, from which on a friction slips; poles are reflected to this times their inverse
FORGOTTEN = float(np.exp(-1))  # of what a start does: below it is forgotten, and in one sample by a pole of less
EDGE = 0.9995  # poles from here on are reflected

BEST = 2  # of the one-step minima, how many are starts
BLOCK, CHUNK = 64, 2048  # rows that are filtered by one product, and that are held filtered at a time
HUGE = 1e9  # in the place of what diverges
DEPENDENT, TINY = 1e-10, 1e-7  # a smaller singular value, and a smaller share of a column's energy, is rounding

# ---- the picture of the misfit --------------------------------------------------------------------------------------
CELLS, LEAST = 12, 10  # of a panel; samples in each, and three correlation lengths
TOLD = 0.02  # share of a panel that is taken off before a line is looked for
CYCLE = 10  # samples of the working rate in the shortest cycle that is kept, which holds 99.9 % of the output's power
SHIFTS = 99  # of what a view leaves, against its variable: what chance makes of the means
BAND = 4.0  # standard deviations of chance, to either side: one cell of 16 000 leaves it, or one portrait of a hundred
FAINT = 0.05  # share below which a view shows nothing
TWICE = 2  # times what a variable explains alone, two must explain together
WIDE = 2  # a spectral line of the Hann window reaches this many bins to each side

# ---- the next experiment ---------------------------------------------------------------------------------------------
SETTLE = 500  # samples of rest before a proposed signal starts
AT_ONCE = 4  # signals per free run: equations are derived once for all of them, but slopes take memory
SMALLER = (0.5, 0.25)  # of the range: tried where no input over all of it decides
SMALLEST = 0.1  # share of half the range; a signal that the rate limit makes smaller is left out
SHORTEST = 12  # samples per period
FAR = 1.0  # a simulated output this many ranges outside the measured one is not believed
CLEARLY = 1.2  # a separation below this many times the present one is no clear gain
VISIBLE = 3.0  # standard errors of the noise, over all samples of the signal
