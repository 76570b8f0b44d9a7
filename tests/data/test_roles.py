"""What columns are: said, seen in the numbers, guessed from name and unit; kept in record, model file and JSON."""

import numpy as np
import pytest
from places import CASES, needs_cases
from sampling import some

import narx_sym as ns
from narx_sym.data.evidence.roles import acting, is_setpoint, roles_of
from narx_sym.errors import DataError
from narx_sym.tasks.base import identify_base

N, TS = 1500, 0.02
RNG = np.random.default_rng(0)
U = np.cumsum(RNG.standard_normal(N)) * 0.1
Y = np.zeros(N)
for k in range(1, N):
    Y[k] = 0.95 * Y[k - 1] + 0.05 * np.tanh(U[k - 1])
OTHER = RNG.standard_normal(N)


def digits(x, count):
    return np.array([float(f"{value:.{count}g}") for value in x])


WRITTEN = {
    "all digits": Y, "noise": Y + 0.01 * OTHER, "six digits": digits(Y + 0.01 * OTHER, 6), "converter": np.round(Y / 0.002) * 0.002,
    "single precision": np.float32(Y + 0.01 * OTHER).astype(float),
}  # fmt: skip
DERIVED = {
    "itself": ("copy-of-y", lambda y: y),
    "in other units": ("copy-of-y", lambda y: 3 - 1000 * y),
    "a sample late": ("copy-of-y", lambda y: np.concatenate([[0.0], y[:-1]])),
    "input in percent": ("copy-of-u", lambda y: 39.2 * U + 1),
    "difference": ("derivative-of-y", lambda y: np.diff(y, prepend=y[0]) / TS),
    "forward difference": ("derivative-of-y", lambda y: np.append(np.diff(y), 0) / TS),
    "gradient": ("derivative-of-y", lambda y: np.gradient(y, TS)),
    "acceleration": ("derivative-of-y", lambda y: np.gradient(np.gradient(y, TS), TS)),
    "sum": ("integral-of-y", lambda y: TS * np.cumsum(y)),
    "sum of the error": ("integral-of-y", lambda y: np.cumsum(1 - y)),
    "trapezoids": ("integral-of-y", lambda y: np.concatenate([[0.0], np.cumsum((y[1:] + y[:-1]) / 2)])),
}


def role(x, y=Y, name="aux", units=None):
    record = ns.Record.from_arrays(U, y, Ts=TS, channels={name: x}, units=units)
    assert bool(record.notes) == (record.roles[name] != "disturbance")
    assert record[100:].roles == record.roles and record[100:].notes == record.notes
    return record.roles[name]


@pytest.mark.parametrize("written", WRITTEN)
@pytest.mark.parametrize("case", DERIVED)
def test_what_the_output_makes_is_seen(case, written):
    wanted, made = DERIVED[case]
    x = made(WRITTEN[written])
    assert role(x, WRITTEN[written]) == role(digits(x, 6), WRITTEN[written]) == wanted


@pytest.mark.parametrize("written", WRITTEN)
def test_what_is_measured_is_not_the_output(written):
    y = WRITTEN[written]
    others = [
        OTHER, U + 0.01 * OTHER, y + 0.05 * OTHER, np.arange(N), np.ones(N), 20 + 0.01 * np.cumsum(OTHER), y**2, np.sin(y),
        np.convolve(y, np.ones(5) / 5, "same"), np.roll(U, 5),
    ]  # fmt: skip
    assert [role(x, y) for x in others] == ["disturbance"] * len(others)


def test_two_levels_are_the_same_only_at_each_sample():
    on = np.sign(np.sin(np.arange(N) / 50))
    for x, wanted in ((0.5 + 0.5 * on, "copy-of-u"), (np.roll(on, 3), "disturbance")):
        assert ns.Record.from_arrays(on, Y, Ts=TS, channels={"p": x}).roles["p"] == wanted


def test_a_measured_speed_needs_its_name_or_unit():
    y, speed = Y + 0.002 * OTHER, np.gradient(Y, TS) + 0.05 * RNG.standard_normal(N)
    assert role(speed, y, "velocity") == "derivative-of-y"
    assert role(speed, y, units={"y": "mm", "aux": "m/s"}) == "derivative-of-y"
    assert role(speed, y) == role(OTHER, y, "wind_speed") == "disturbance"


@pytest.mark.parametrize(
    "name",
    "r R r_deg SP sp_1 Setpoint_m3_h SetPoint set_point Goal_Position target cmd command speed_ref demand reference channel_r".split(),
)
def test_names_of_setpoints(name):
    assert is_setpoint(name) and role(OTHER, name=name) == role(np.ones(N), name=name) == "setpoint"


@pytest.mark.parametrize("name", "rate rTemp load force pwm spring temp preferred".split())
def test_other_names(name):
    assert not is_setpoint(name)


def test_what_is_said_counts():
    channels = {"target": OTHER, "vel": np.gradient(Y, TS), "temp": U + OTHER}
    said = {"target": "input", "vel": "disturbance", "temp": "setpoint"}
    record = ns.Record.from_arrays(U, Y, Ts=TS, channels=channels, roles=said)
    assert record.roles == said and not record.notes and acting(record) == ["target", "vel"]
    with pytest.raises(DataError, match="role of 'tmp', which is no signal"):
        ns.Record.from_arrays(U, Y, Ts=TS, roles={"tmp": "input"})
    with pytest.raises(DataError, match="'temp' has the unknown role 'setpont', did you mean setpoint"):
        ns.Record.from_arrays(U, Y, Ts=TS, channels=channels, roles={"temp": "setpont"})


def test_options_are_read():
    assert roles_of("a [V]=input, b = ignore,") == {"a [V]": "input", "b": "ignore"} and roles_of("") == {}
    for text, words in (
        ("a", "give names with their roles"),
        ("=input", "give names"),
        ("a=pump", "unknown role 'pump'"),
    ):
        with pytest.raises(DataError, match=words):
            roles_of(text)


def file(folder, names, *columns):
    path = folder / "rig.csv"
    path.write_text(
        names + "\n" + "\n".join(",".join(f"{v:.6g}" for v in row) for row in zip(*columns, strict=True)) + "\n"
    )
    return path


def test_roles_of_columns(tmp_path):
    path = file(tmp_path, "t,u,y,temp [C],v,index", TS * np.arange(N), U, Y, OTHER, np.gradient(Y, TS), np.arange(N))
    record = ns.read(path, channels="all", roles={"temp": "input", "index": "ignore"})
    assert record.roles == {"temp": "input", "channel_v": "derivative-of-y", "index": "ignore"}
    assert list(record.channels) == ["temp", "channel_v"] and record.aside == ()
    assert ns.read(path, roles={"temp_C": "disturbance"}).roles == {"temp_C": "disturbance"}
    assert ns.read(path, roles={"u": "input", "t": "ignore"}).roles == {}
    for roles, words in (
        ({"tem": "input"}, "no column 'tem';.*choose with --role"),
        ({"y": "setpoint"}, "'y' is the output"),
    ):
        with pytest.raises(DataError, match=words):
            ns.read(path, roles=roles)


@pytest.mark.parametrize(
    "name", some(["v", "x", "k", "r", "phi1", "free", "prediction", "lambda", "C", "pi", "c", "theta_1"], 6)
)
def test_every_name_works(name, run, tmp_path):
    y = np.zeros(600)
    for k in range(1, 600):
        y[k] = 0.8 * y[k - 1] + 0.2 * U[k - 1] + 0.1 * OTHER[k]
    path = file(tmp_path, f"t,u,y,{name}", TS * np.arange(600), U[:600], y, OTHER[:600])
    base, out = tmp_path / "base.json", tmp_path / "m.json"
    options = ("--role", f"{name}=disturbance")
    for words in (
        ("fit", path, "--base", "linear", "--n-y", 1, "--n-u", 1, "--delay", 1, "--out", base),
        ("add", base, f"channel:{name}", path, "--out", out, *options),
        ("compare", out, path, "--no-plot", *options),
    ):
        run.good(*words)
    (own,) = ns.load(out).channels
    assert own in (name, f"channel_{name}") and ns.load(out).info.roles == {own: "disturbance"}
    assert ns.evaluate(ns.load(out), ns.read(path, roles={name: "disturbance"})).free_run_nrmse < 0.02


def test_roles_go_into_model_and_json(run, tmp_path):
    path = file(tmp_path, "t,u,y,cmd,vel", TS * np.arange(N), U, Y, OTHER, np.gradient(Y, TS))
    out = tmp_path / "m.json"
    fit = ("fit", path, "--base", "linear", "--n-y", 1, "--n-u", 1, "--delay", 1, "--out", out)
    code, _, err = run(*fit, "--channels", "all", "--role", "cmd=ignore")
    assert code == 0 and "derivative of the output" in err and "is not used (give lags" not in err, err
    assert ns.load(out).info.roles == {"cmd": "ignore", "vel": "derivative-of-y"}
    code, _, err = run(*fit, "--role", "cmd=disturbance")
    assert code == 0 and "setpoint" not in err and ns.load(out).info.roles == {"cmd": "disturbance"}
    code, _, err = run("compare", out, path, "--no-plot", "--role", "cmd=pump")
    assert code == 2 and "unknown role 'pump'" in err
    model = ns.load(out)
    told = ns.diagnose(model, ns.read(path, channels="cmd"), roles={"cmd": "setpoint"}).to_dict()
    assert told["roles"] == {"cmd": "setpoint"} and told["verdict"] == "closed_loop"


def test_a_channel_at_one_long_lag_is_fitted():
    y = np.zeros(600)
    y[25:] = 0.5 * U[24:599] + OTHER[:575]
    record = ns.Record.from_arrays(U[:600], y, Ts=TS, channels={"load": OTHER[:600]})
    model = ns.identify(record, base="linear", n_y=1, n_u=1, delay=1, lags={"load": 25})
    assert ns.evaluate(model, record).free_run_nrmse < 1e-6


@needs_cases
def test_channels_that_once_were_taken_for_what_is_missing():
    for name in ("vel", "v"):
        record = ns.read(CASES / f"cart_{name}.csv", y="x", channels=name)
        assert list(record.roles.values()) == ["derivative-of-y"] and acting(record) == []
        assert "derivative of the output" in record.notes[-1] and "--role" in record.notes[-1]
    record = ns.read(CASES / "two_slow.csv", u="u1", y="y", channels="u2")
    assert acting(record) == ["u2"]
    assert ns.evaluate(ns.identify(record, base="linear", lags={"u2": 25}), record).free_run_nrmse < 0.5
    assert ns.evaluate(identify_base("linear", [record]), record).free_run_nrmse < 0.003  # 0.5 without u2
    assert identify_base("play", [record]).channels == ()
    loop = ns.read(CASES / "tec_redco_MIT.csv", u="current", y="temperature", t="time")
    assert loop.roles == {"command": "setpoint"}
