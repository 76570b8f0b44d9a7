"""Long work goes on where it was interrupted, and gives what the uninterrupted work gives."""

import json
import random
import re
from pathlib import Path

import kill
import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st

import narx_sym as ns
from narx_sym.errors import DataError, FitError
from narx_sym.files import journal
from narx_sym.files.journal import alive, digest, plain, remembered
from narx_sym.files.parallel import sweep
from narx_sym.fit.bootstrap import block_bootstrap

CALLS = []


def work(number, array=None):
    CALLS.append(number)
    if number < 0:
        raise FitError("negative")
    return [np.arange(3) * number / 7, (number, None), {"a": float("nan")}]


@pytest.fixture(autouse=True)
def counted():
    CALLS.clear()


def same(a, b):
    return json.dumps(plain(a)) == json.dumps(plain(b))


def test_a_sweep_computes_only_what_is_missing(tmp_path):
    calls = [(i, np.ones(2)) for i in range(6)]
    expected = sweep(work, calls)
    CALLS.clear()
    with ns.resuming(tmp_path / "j"):
        sweep(work, calls[:4])
    assert CALLS == [0, 1, 2, 3]
    with ns.resuming(tmp_path / "j") as kept:
        assert same(sweep(work, calls), expected)
    assert CALLS == [0, 1, 2, 3, 4, 5] and kept.found == 4 and len(kept) == 6
    assert same(sweep(work, calls[:1]), expected[:1]) and CALLS[-1] == 0  # without a journal: computed


def test_other_data_are_other_results(tmp_path):
    with ns.resuming(tmp_path / "j") as kept:
        sweep(work, [(1, np.ones(2))])
        sweep(work, [(1, np.array([1.0, 1.0 + 1e-16])), (1, np.array([1.0, 1.0 + 1e-15])), (1, np.ones(2, dtype=int))])
    assert kept.found == 1 and CALLS == [1, 1, 1]


def test_a_failed_fit_is_kept_too(tmp_path):
    with ns.resuming(tmp_path / "j"):
        for _ in range(3):
            with pytest.raises(FitError, match="negative"):
                remembered(work, -1)
    assert CALLS == [-1]


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5)
    | st.lists(st.floats(width=32), max_size=4).map(lambda x: np.array(x, dtype="f4")) | st.floats().map(np.float64),
    lambda inner: st.lists(inner, max_size=3) | st.lists(inner, max_size=3).map(tuple)
    | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(values)
def test_results_come_back_bit_for_bit(value):
    back = alive(json.loads(json.dumps(plain(value))))
    assert same(back, value) and type(back) is type(value)
    assert digest(back) == digest(value)


def test_a_digest_tells_things_apart():
    record = ns.Record.from_arrays([0.0, 1.0], [1.0, 2.0], Ts=0.1)
    other = ns.Record.from_arrays([0.0, 1.0], [1.0, 2.0], Ts=0.2)
    model = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])
    changed = model.replace(theta=[0.5, 1.0 + 1e-15])
    constrained = model.replace(constraints=("continuum",))
    things = [
        None, 0, 0.0, False, "", "0", b"", (), [], {}, (1, 2), ((1,), 2), (1, (2,)), "12", ("1", "2"), ("12",), -0.0, 1, 1.0, True,
        np.zeros(2), np.zeros((2, 1)), np.zeros((1, 2)), np.zeros(2, dtype=int), [0.0, 0.0], slice(1, 2), range(1, 2), {"a": 1}, {"a": 2},
        sp.Symbol("a"), sp.Symbol("a", real=True), sp.Integer(1), ns.y[ns.k], ns.y[ns.k - 1], record, other, record[:2], model, changed,
        constrained, work, same, Path("a"), "a", {1, 2}, {1, 3},
    ]  # fmt: skip
    found = [digest(t) for t in things]
    assert len(set(found)) == len(things) - 1 and digest(record) == digest(record[:2])
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1}) and digest(model) == digest(model.replace())
    model.recursion.depth, model.right, model.recurrent  # what is derived and kept does not count
    assert digest(model) == digest(ns.NARX(model.terms, model.theta))


@pytest.mark.parametrize("thing", (object(), np.array([{}]), lambda: digest))
def test_what_cannot_be_told_apart_is_refused(thing):
    free = thing if not callable(thing) else (lambda a: lambda: a)(1)
    with pytest.raises(DataError, match=r"cannot be compared|closure"):
        digest(free)
    with pytest.raises(DataError, match="cannot be saved"):
        plain(object())


def filled(path):
    with ns.resuming(path):
        sweep(work, [(i,) for i in range(5)])
    CALLS.clear()
    return path.read_bytes()


@pytest.mark.parametrize("cut", range(2, 400, 37))
def test_a_line_that_was_cut_off_is_computed_again(cut, tmp_path):
    path = tmp_path / "j"
    raw = filled(path)
    path.write_bytes(raw[:-cut])
    with ns.resuming(path):
        sweep(work, [(i,) for i in range(5)])
    assert CALLS and path.read_bytes() == raw


def test_a_changed_line_is_not_believed(tmp_path):
    path = tmp_path / "j"
    raw = filled(path)
    lines = raw.decode().split("\n")
    lines[2] = lines[2].replace('"value": ["result"', '"value": ["resulT"').replace("[1, null]", "[2, null]")
    path.write_text("\n".join(lines))
    with ns.resuming(path):
        sweep(work, [(i,) for i in range(5)])
    assert CALLS == [1]


def test_a_journal_of_other_code_and_other_files_are_refused(tmp_path, monkeypatch):
    filled(tmp_path / "j")
    before = (tmp_path / "j").read_bytes()
    monkeypatch.setattr(journal, "code", lambda: "other")
    with pytest.raises(DataError, match="another version"), ns.resuming(tmp_path / "j"):
        pass
    assert (tmp_path / "j").read_bytes() == before
    for content in (b"t,u,y\n0,1,2\n", b"\xff\xfe", b"{}", b"[1]\n"):
        (tmp_path / "data.csv").write_bytes(content)
        with pytest.raises(DataError, match=r"data\.csv"), ns.resuming(tmp_path / "data.csv"):
            pass
        assert (tmp_path / "data.csv").read_bytes() == content
    with pytest.raises(DataError, match="does not exist"), ns.resuming(tmp_path / "no" / "j"):
        pass


def test_a_hostile_journal_runs_nothing(tmp_path):
    path = tmp_path / "j"
    raw = filled(path).decode().split("\n")
    for bad in (
        '{"key": 1}',
        "[" * 10_000,
        '{"key": [], "sum": 0, "value": {"array": ["|O", [1], "gASV"]}}',
        "null",
        "\0",
    ):
        path.write_text("\n".join([raw[0], bad, *raw[1:]]))
        with ns.resuming(path) as kept:
            assert len(kept) == 5


def test_bootstrap_and_many_starts_go_on(tmp_path):
    base, record = kill.two_effects()
    record = record[:300]
    plain_run = block_bootstrap(base, record, draws=4)
    for _ in range(2):
        with ns.resuming(tmp_path / "j") as kept:
            found = block_bootstrap(base, record, draws=4)
        assert np.array_equal(found.thetas, plain_run.thetas)
    assert kept.found == 4


@pytest.mark.long
def test_killed_while_it_saves():
    assert kill.saves(3, random.Random(1)) == []


@pytest.mark.long
def test_killed_while_it_sweeps():
    assert kill.resumes(kill.SWEEP.format(root=str(kill.ROOT), count=40), 2, random.Random(2), "sweep") == []


@pytest.mark.long
def test_diagnose_resumes(run, tmp_path, monkeypatch):
    """Stopped in the middle, started again: the same JSON but for the seconds, and fits are not repeated."""
    base, record = kill.two_effects()
    ns.save(base, tmp_path / "m.json")
    rows = np.column_stack([record.t, record.u, record.y])[:300]
    (tmp_path / "d.csv").write_text("t,u,y\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows))

    def diagnosed(name, *more):
        code, _, err = run(
            "diagnose", tmp_path / "d.csv", "--base", tmp_path / "m.json", "--json", tmp_path / name, *more
        )
        found = (tmp_path / name).read_text() if code == 0 else ""
        return code, found.partition('"seconds"')[0], err

    code, expected, _ = diagnosed("a.json")
    assert code == 0
    real, count = journal.Journal.keep, []

    def stopped(self, *args):
        real(self, *args)
        count.append(1)
        if len(count) == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(journal.Journal, "keep", stopped)
        code, _, err = diagnosed("b.json", "--resume", tmp_path / "j")
    assert code == 130 and not (tmp_path / "b.json").exists()  # the line about it is the process's own: test_atomic.py
    code, found, err = diagnosed("b.json", "--resume", tmp_path / "j")
    assert code == 0 and found == expected
    assert int(re.search(r"(\d+) results were taken from", err)[1]) >= 4  # one may be asked for more than once
