"""A law starts where the machine rests, inside its limits; one that rings is damped, and says so."""

import shutil
import subprocess
import warnings

import numpy as np
import pytest
from paper import BENCH, VALVE

import narx_sym as ns
from narx_sym.errors import Diverged, ModelError
from narx_sym.models.info import Info

Ts = 1e-3
gcc = shutil.which("gcc")
POLES = (1.2, -0.65)


def ringing(zero, gain=0.5):
    """A resonance whose zero is given, with the ranges of a record."""
    b = gain * (1 - sum(POLES)) / (1 - zero)
    info = Info(ranges={"u": (0.0, 100.0), "y": (0.0, 50.0)}, line=(1.0, gain), start=(0.0, 0.0))
    terms = ["y[k-1]", "y[k-2]", "u[k-1]", "u[k-2]"]
    return ns.NARX.from_terms(terms, [*POLES, b, -zero * b], Ts=Ts).replace(info=info)


def wave(n=1500):
    """A reference that begins at rest, moves by smooth steps, and rests."""
    slow = 0.5 - 0.5 * np.cos(np.pi * np.clip(np.arange(n) / (n - 500), 0, 1))
    return 40.0 * slow


def quietly(law, *arguments, **options):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return law.run(*arguments, **options)


@pytest.mark.parametrize("zero", (-0.9, -0.97, -1.0, -1.1, -1.5, -3.0))
def test_a_law_that_rings_is_damped(zero):
    """Near -1 and beyond: the input moves no more than the reference asks, and the output stays on its way."""
    model, goal = ringing(zero), wave()
    law = model.compensator()
    assert law.damping().rings and 0 < law.share() < 1
    for options in ({"m0": 0.0}, {"m0": 5.0}, {"limits": (0.0, 100.0)}):
        m = quietly(law, goal, **options)
        assert np.abs(np.diff(m[-100:])).max() < 1e-6
        assert np.abs(model.simulate(m, 0.0, u0=0.0, warn=False) - goal)[300:].max() < 0.0035 * np.ptp(goal)
        assert ns.nsavi(m, goal) < 1.5 * 2.0 + 10.0 / np.ptp(goal) * (options.get("m0") == 5.0)  # 2 V per unit of y


def test_the_poles_are_those_of_the_root_locus():
    """a B + (1 - a) (1 - 1/z) b_0 A, derived by hand, forgets as fast as is said."""
    model = ringing(-1.05)
    damping, b = model.compensator().damping(), model.theta[2:]
    a, A = damping.share, [1.0, -POLES[0], -POLES[1]]
    locus = a * np.array([*b, 0, 0]) + (1 - a) * b[0] * np.convolve([1, -1], A)
    slowest = np.abs(np.roots(locus)).max()
    assert slowest < 1 and damping.damped == pytest.approx(np.log(0.01) / np.log(slowest), abs=4)
    nearer = 1 - (1 - a) / 4
    other = nearer * np.array([*b, 0, 0]) + (1 - nearer) * b[0] * np.convolve([1, -1], A)
    assert np.abs(np.roots(other)).max() > slowest


def test_what_an_undamped_law_does():
    law, goal = ringing(-0.97).compensator(), wave()
    m = quietly(law, goal, 5.0, share=None)
    assert np.abs(np.diff(m[:100])).max() > 5.0 and ns.nsavi(m, goal) > 5
    with pytest.raises(Diverged):
        quietly(ringing(-1.5).compensator(), goal, 5.0, share=None)


def test_it_is_said_with_its_reason():
    law = ringing(-0.97).compensator()
    assert law.check().points == 0
    with pytest.warns(UserWarning, match="zero near -1.*So the law is damped"):
        law.run(wave(), 0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        law.run(wave(), 0.0, share=None)


@pytest.mark.parametrize(
    "law", (ringing(-0.5).compensator(), ringing(0.3).compensator(), BENCH.published(Ts=Ts).compensator(),
            VALVE.published(Ts=0.01).compensator())
)  # fmt: skip
def test_what_does_not_ring_is_left_as_it_is(law):
    """The zeros of the paper's laws are elsewhere."""
    assert law.share() == 1 and not law.damping().sentence
    goal = 3 + 0.5 * np.sin(np.arange(300) / 60)
    assert (quietly(law, goal, 3.0, clip=True) == quietly(law, goal, 3.0, clip=True, share=None)).all()


@pytest.mark.parametrize("zero", (0.98, 1.0, 1.02, 1.035, 1.5))
def test_what_grows_without_turning_back_does_not_ring(zero):
    """A zero at 1.02, of a machine that first goes the other way: no part of the way would cure it."""
    law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, -zero]).compensator()
    assert law.share() == 1 and not law.damping().rings


def test_how_long_it_rings_is_a_least_where_it_is_not_seen_to_end():
    for zero, said in ((-0.9, "lasts for 4"), (-0.99, "lasts for at least"), (-1.02, "lasts for at least")):
        law = ns.NARX.from_terms(["y[k-1]", "u[k-1]", "u[k-2]"], [0.5, 1.0, -zero]).compensator()
        assert said in law.damping().sentence


@pytest.mark.skipif(gcc is None, reason="no gcc in PATH")
def test_the_source_is_damped_too(tmp_path):
    law, goal = ringing(-1.1).compensator(), wave(600)
    source = law.export("c")
    assert source != law.export("c", share=None) and law.export("c", share=law.share()) == source
    (tmp_path / "law.c").write_text(source)
    subprocess.run([gcc, tmp_path / "law.c", "-DLAW_SELF_TEST", "-o", tmp_path / "law", "-lm"], check=True)
    subprocess.run([tmp_path / "law"], check=True)
    assert np.isfinite(quietly(law, goal, 0.0)).all()


@pytest.mark.parametrize("share", (0.0, 1.5, -1, "much"))
def test_shares_that_are_none(share):
    with pytest.raises(ModelError, match="share"):
        ringing(-0.97).compensator().run(wave(), 0.0, share=share)


# -- the start -------------------------------------------------------------------------------------------------


def test_a_law_starts_where_its_model_rests():
    """The line through the data need not pass there: it has an offset where loops lie on one side."""
    model = ringing(-0.5)  # its line says m = -2 at r = 0
    law = model.compensator()
    assert law.rest_input(10.0) == pytest.approx(20.0, abs=1e-9)
    m = quietly(law, np.full(50, 10.0))
    assert m == pytest.approx(np.full(50, 20.0), abs=1e-6)
    assert law.rest_input(10.0, (0.0, 15.0)) == 15.0


def test_of_a_continuum_the_recorded_start_is_taken():
    u = 50 - 50 * np.cos(np.arange(4000) / 300)  # from 0 to 100 V and back: the loops lie on one side
    record = ns.Record.from_arrays(u, ns.plants.bouc_wen(u, Ts), Ts=Ts)
    model = BENCH.model().fit(record, ["continuum"])
    law = model.compensator()
    line = -model.info.line[0] / model.info.line[1]
    assert line < -5 and law.rest_input(0.0) == pytest.approx(0.0, abs=1e-9)
    assert law.rest_input(-30.0, (0.0, 100.0)) == 0.0 and law.rest_input(-30.0) == 0.0
    assert quietly(law, np.full(30, 0.0)) == pytest.approx(np.zeros(30), abs=1e-9)


def test_the_command_damps_and_says_so(run, tmp_path):
    ns.save(ringing(-0.97), tmp_path / "m.json")
    np.savetxt(tmp_path / "r.csv", np.c_[np.arange(1500) * Ts, wave()], header="t,r", delimiter=",", comments="")
    swings = {}
    for share in ("auto", "none", "0.4"):
        given = ("--reference", tmp_path / "r.csv", "--out", tmp_path / "m.csv", "--m0", 5, "--share", share)
        text, _ = run.good("compensate", tmp_path / "m.json", *given)
        assert ("So the law is damped" in text.replace("\n", " ")) == (share == "auto")
        m = np.loadtxt(tmp_path / "m.csv", delimiter=",", skiprows=1)[:, 2]
        swings[share] = np.abs(np.diff(m[50:150])).max()
    assert swings["auto"] < 0.3 > swings["0.4"] and swings["none"] > 1
