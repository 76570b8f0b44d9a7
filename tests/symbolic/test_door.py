"""What a door shows: the real function, its arguments and its text."""

import inspect
import pydoc

import jedi
import pytest
import stubs

import narx_sym as ns
from narx_sym.fit.simulate import simulate
from narx_sym.models.analysis import sigma_y
from narx_sym.models.doors import ModelDoors


def model() -> ns.NARX:
    return ns.NARX.from_terms(["y[k-1]", "u[k-1]"], [0.5, 1.0])


def test_a_method_is_the_function_with_the_object_put_in() -> None:
    assert ns.Model.simulate is simulate
    assert model().simulate.__func__ is simulate
    assert list(inspect.signature(model().simulate).parameters) == list(inspect.signature(simulate).parameters)[1:]
    assert "free run" in pydoc.render_doc(model().simulate)
    assert model().simulate([1.0, 1.0, 1.0], 0.0).tolist() == [0.0, 1.0, 1.5]


def test_an_attribute_is_looked_up_and_shows_its_text_too() -> None:
    found = model()
    assert found.sigma_y == sigma_y(found) == found.symbols[0]
    assert ns.Model.sigma_y.__doc__ == sigma_y.__doc__


def test_the_help_of_a_class_lists_what_lives_in_later_rooms() -> None:
    text = pydoc.plain(pydoc.render_doc(ns.Model))
    for name in vars(ModelDoors):
        assert name.startswith("_") or any(f"  {name}{end}" in text for end in ("(", " = ", "\n")), name


@pytest.mark.parametrize("file", stubs.DOORS, ids=lambda f: f.parent.name)
def test_the_stubs_are_those_of_the_doors(file):
    assert file.with_suffix(".pyi").read_text(encoding="utf-8") == stubs.stub(file), "run: python tests/stubs.py"


COMPLETED = [
    ("model.", "fit", "constraints"), ("model.fit(record).", "simulate", "y0"), ("law.", "run", "reference"),
    ("model.add('creep').fit(record).", "compensator", "force"), ("found.", "report", "path"), ("found.best.", "latex", ""),
]  # fmt: skip


def test_an_editor_completes_what_stands_behind_a_door(tmp_path, monkeypatch):
    # Workers would read each other's half-written files.
    monkeypatch.setattr(jedi.settings, "cache_directory", str(tmp_path))
    for typed, name, shown in COMPLETED:
        code = "\n".join([
            "import narx_sym as ns", "record = ns.read('a.csv')", "model = ns.identify(record)",
            "law = model.compensator()", "found = ns.diagnose(model, record)", typed,
        ])  # fmt: skip
        offered = {c.name: c for c in jedi.Script(code).complete()}
        assert name in offered, typed
        assert not shown or shown in offered[name].get_signatures()[0].to_string()
