"""What kind of machine was measured: told by units, effects that it rules out, and what is one thing there."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from sampling import only

import narx_sym as ns
from narx_sym.cli import main as cli
from narx_sym.diagnosis import steps
from narx_sym.diagnosis.machine import Machine, machine_of
from narx_sym.diagnosis.steps import Step, as_one
from narx_sym.diagnosis.table.verdict import verdict
from narx_sym.errors import ModelError
from narx_sym.models.effects import EFFECTS, MACHINES, Catalogue, effect

TOLD = {
    "W -> degC": "thermal", "kW -> K": "thermal", "A -> degC": "thermal", "V -> um": "smart-material",
    "V -> µm": "smart-material", "kV -> nm": "smart-material", "A/m -> T": "smart-material", "V -> rad/s": "drive",
    "A -> rpm": "drive", "N m -> deg/s": "drive", "V -> m/s": "drive", "mm -> N": "motion-force",
    "mm/s -> kN": "motion-force", "L/min -> cm": "tank", "m^3/h -> degC": "process",
}  # fmt: skip
NOT_TOLD = (
    "V -> V", "A -> V", "% -> %", "% -> degC", "mA -> degC", "V -> degC", "V -> mm", "V -> deg", "N -> mm", "kPa -> deg",
    "rpm -> N", "1 -> 1", "inc -> degC", "degC -> degC",
)  # fmt: skip


def units(text):
    return dict(zip(("u", "y"), text.split(" -> "), strict=True))


@pytest.mark.parametrize("text", TOLD)
def test_units_tell_a_machine(text):
    assert machine_of("", units(text)) == Machine(TOLD[text], guessed=True)


@pytest.mark.parametrize("text", NOT_TOLD)
def test_other_units_tell_none(text):
    assert machine_of("", units(text)) == Machine()


def test_what_the_user_says_comes_first():
    assert machine_of("battery", units("W -> degC")) == Machine("battery")
    assert machine_of("none", units("W -> degC")) == machine_of("", {"u": "W"}) == machine_of("", {}) == Machine()
    with pytest.raises(
        ModelError, match=r"Unknown machine 'termal', did you mean thermal\?; machines are thermal, .*none"
    ):
        machine_of("termal", {})


def test_a_catalogue_of_a_machine_lacks_what_is_impossible_there():
    heater = EFFECTS.of("thermal")
    assert {"coulomb_friction", "stiction", "backlash", "quadratic_drag", "sqrt_outflow"} <= set(heater.excluded)
    assert not set(heater.excluded) & set(heater) and {*heater, *heater.excluded} == set(EFFECTS.of(""))
    assert not EFFECTS.of("").excluded and not EFFECTS.of("").meanings
    assert [e.form for e in EFFECTS.of("process")["stiction"]] == ["of a valve"]  # what holds a state needs a mass


@pytest.mark.parametrize("name", MACHINES)
def test_forms_of_one_effect_mean_one_thing(name):
    for forms in EFFECTS.of(name).values():
        assert len({e.means.get(name, "") for e in forms}) == 1
    assert all("_" not in words for words in EFFECTS.of(name).meanings.values())


def test_an_effect_names_machines_that_there_are():
    with pytest.raises(ModelError, match="a machine is one of thermal"):
        effect("input", id="wrong", never="heater", register=False)(lambda x: x)


def test_what_is_one_thing_in_a_machine_is_named_not_confused():
    names = ["quadratic_spring", "hardening_spring", "saturation"]
    known = EFFECTS.of("thermal").meanings
    assert as_one(names, {}) == (names, {})
    assert as_one(names, known) == (["quadratic_spring", "saturation"], {"quadratic_spring": ["hardening_spring"]})
    for meanings, said in (({}, "confused"), (known, "named")):
        assert verdict(0.95, 0.0, len(as_one(names[:2], meanings)[0])) == said
    assert as_one(["coulomb_friction", "channel_friction:load"], EFFECTS.of("drive").meanings)[1] == {
        "coulomb_friction": ["channel_friction:load"]
    }


def test_people_read_the_words_of_the_machine_beside_the_id():
    known = EFFECTS.of("smart-material").meanings
    told = SimpleNamespace(meanings=known)
    assert Step.told(told, "coulomb_friction", "creep", "hysteresis") == [
        "hysteresis (coulomb_friction and hysteresis)",
        "creep",
    ]
    assert Step.told(told, "hysteresis") == ["hysteresis"] and Step.told(told, "end_stop:x") == ["end_stop:x"]


# -- a heater ------------------------------------------------------------------------------------------------------

RUBS = EFFECTS["coulomb_friction"][:1]  # one form is enough to be excluded
FEW = Catalogue({**only("quadratic_spring", "hardening_spring", "dead_zone"), "coulomb_friction": RUBS})


@pytest.fixture(scope="module")
def heater():
    """A first-order heater whose losses grow with the square of its temperature; the record, and a linear base."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.uniform(0.0, 10.0, 60), 15)
    y = np.zeros(u.size)
    for i in range(1, u.size):
        y[i] = y[i - 1] + 0.1 * u[i - 1] - 0.05 * y[i - 1] - 0.004 * y[i - 1] ** 2
    y += 20.0 + 0.01 * rng.standard_normal(u.size)
    record = ns.Record.from_arrays(u, y, Ts=1.0, units={"u": "W", "y": "degC"})
    return record, ns.identify(record, base="linear", n_y=1, n_u=1, delay=1)


@pytest.fixture(scope="module")
def found(heater):
    return ns.diagnose(heater[1], heater[0], catalogue=FEW)


def test_a_guess_is_told_and_excludes(found):
    (note,) = [n for n in found.data_notes if "machine" in n]
    assert note.startswith("The machine is assumed to be a thermal machine, because of the units W -> degC")
    assert "--machine none" in note and note.endswith(
        "Not considered, because impossible in a thermal machine: Coulomb friction."
    )
    plain = found.to_dict()
    assert plain["machine"] == {"name": "thermal", "guessed": True, "excluded": ["coulomb_friction"]}
    assert plain["excluded"] == {"coulomb_friction": "impossible for a thermal machine"}
    tried = {v.id for row in found.hypotheses for v in row.hypothesis.effects}
    assert "quadratic_spring" in tried and "coulomb_friction" not in tried
    assert found.model.info.machine == ""  # units that are in the file tell it again


def test_it_is_named_in_words_of_its_field(found):
    from narx_sym.report.words import headline

    assert found.verdict == "named" and found.best.effect in ("quadratic_spring", "hardening_spring")
    words = f"a loss that grows faster than linearly ({found.best.effect})"
    assert f"Probably missing: {words} (more than 99 %)." in found.sentence() and "spring that" not in found.sentence()
    assert headline(found) == f"{words[0].upper()}{words[1:].replace('_', ' ')} is probably missing."
    (first, *_) = found.to_dict()["candidates"]
    assert first["effect"] == found.best.effect
    assert first["sentence"].startswith("A loss that grows faster than linearly.")


def test_synonyms_are_listed_as_the_same_thing(found):
    one = replace(found.steps[0], confusion_set=["quadratic_spring"], same={"quadratic_spring": ["hardening_spring"]})
    assert one.sentence({}).endswith("hardening_spring is the same thing as quadratic_spring here.")
    assert one.to_dict(None)["same_thing"] == {"quadratic_spring": ["hardening_spring"]}


def test_none_switches_the_guess_off_and_a_model_keeps_what_was_said(heater, tmp_path):
    record, base = heater
    off = ns.diagnose(base, record, catalogue=Catalogue({"coulomb_friction": RUBS}), machine="none")
    assert off.to_dict()["machine"] is None and off.to_dict()["excluded"] == {} and off.model.info.machine == "none"
    assert "coulomb_friction" in {v.id for row in off.hypotheses for v in row.hypothesis.effects}
    assert not any("machine" in n for n in off.data_notes)
    off.model.save(tmp_path / "m.json")
    again = ns.load(tmp_path / "m.json")
    assert again.info.machine == "none" and steps.meaning("quadratic_spring", {}) == "quadratic_spring"
    text = json.loads((tmp_path / "m.json").read_text())
    text["info"]["machine"] = "heater"
    (tmp_path / "m.json").write_text(json.dumps(text))
    with pytest.raises(ModelError, match=r"'info.machine' must be one of thermal"):
        ns.load(tmp_path / "m.json")


def test_the_command_says_the_guess_and_refuses_an_unknown_machine(heater, tmp_path, monkeypatch, capsys):
    record, base = heater
    rows = np.column_stack([record.t, record.u, record.y])
    np.savetxt(tmp_path / "heater.csv", rows, delimiter=",", header="t,u [W],y [degC]", comments="")
    base.save(tmp_path / "base.json")
    monkeypatch.setattr("narx_sym.cli.diagnose.with_own", lambda files: only("dead_zone"))

    def run(*more):
        command = ["narx-sym", "diagnose", str(tmp_path / "heater.csv"), "--base", str(tmp_path / "base.json"), *more]
        monkeypatch.setattr("sys.argv", command)
        with pytest.raises(SystemExit) as stop:
            cli.main()
        return stop.value.code or 0, capsys.readouterr()

    code, said = run("--json", str(tmp_path / "d.json"))
    assert code == 0 and "note: The machine is assumed to be a thermal machine" in said.err
    assert json.loads((tmp_path / "d.json").read_text())["machine"]["name"] == "thermal"
    code, said = run("--machine", "heater")
    assert code == 2 and "Unknown machine 'heater'" in said.err and "smart-material" in said.err
