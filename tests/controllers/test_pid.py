"""The PID against its transfer function, an independent simulation, and its own exports."""

import math
import shutil
import subprocess

import numpy as np
import pytest

from zoac.controllers.pid import PID
from zoac.controllers.pid_export import export_pid
from zoac.core.errors import ConfigError

TS = 0.05
GAINS = {"Kp": 2.0, "Ki": 1.5, "Kd": 0.4, "Tf": 0.1}


def run(pid, gains, y, r):
    """Return the outputs (K,) of one controller."""
    memory, outputs = pid.init(1), []
    for measured, reference in zip(y, r, strict=True):
        u, memory = pid.step(gains, np.array([measured]), np.array([reference]), memory)
        outputs.append(u[0])
    return np.array(outputs)


def by_hand(gains, y, r, *, b, c, low, high, move, windup, tracking, first):
    """The textbook's controller in scalars, written without looking at the other."""
    kp, ki, kd, tf = gains
    integral, slope, out = 0.0, 0.0, []
    held = None if first is None else first
    for k in range(len(y)):
        p = kp * (b * r[k] - y[k])
        if k:
            slope = (tf * slope + kd * (c * (r[k] - r[k - 1]) - (y[k] - y[k - 1]))) / (tf + TS)
        elif first is not None:
            integral = first - p
        wanted = p + integral + slope
        given = wanted
        if held is not None:
            given = min(max(given, held - move), held + move)
        given = min(max(given, low), high)
        add = ki * TS * (r[k] - y[k])
        if windup == "clamping" and ((wanted > given and add > 0) or (wanted < given and add < 0)):
            add = 0.0
        if windup == "back_calculation":
            add += TS / tracking * (given - wanted)
        integral += add
        held = given
        out.append(given)
    return np.array(out)


def test_without_limits_it_is_its_transfer_function():
    control = pytest.importorskip("control")
    z = control.TransferFunction([1, 0], [1], TS)
    kp, ki, kd, tf = GAINS.values()
    transfer = kp + ki * TS / (z - 1) + kd * (z - 1) / ((tf + TS) * z - tf)
    error = np.random.default_rng(0).normal(size=300)
    error[0] = 0.0
    _, expected = control.forced_response(transfer, inputs=error)
    pid = PID(sample_time=TS, c=1.0, anti_windup="none")
    outputs = run(pid, tuple(GAINS.values()), -error, np.zeros(300))
    np.testing.assert_allclose(outputs, expected.ravel(), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("windup", ["none", "clamping", "back_calculation"])
@pytest.mark.parametrize(("first", "rate"), [(None, math.inf), (0.3, 4.0), (None, 4.0)])
def test_with_limits_it_is_the_textbooks(windup, first, rate):
    rng = np.random.default_rng(1)
    y, r = rng.normal(size=200).cumsum() * 0.2, np.sign(rng.normal(size=200)).cumsum() * 0.1
    pid = PID(
        sample_time=TS, b=0.7, c=0.2, output_limits=(-1.0, 1.5), rate_limit=rate,
        anti_windup=windup, tracking_time=0.5, initial_output=first,
    )  # fmt: skip
    expected = by_hand(
        tuple(GAINS.values()), y, r, b=0.7, c=0.2, low=-1.0, high=1.5, move=rate * TS,
        windup=windup, tracking=0.5, first=first,
    )  # fmt: skip
    np.testing.assert_allclose(run(pid, tuple(GAINS.values()), y, r), expected, rtol=1e-12)


def test_a_batch_is_its_controllers_one_by_one():
    rng = np.random.default_rng(2)
    pid = PID(sample_time=TS, y=0, r=1, output_limits=(-1, 1))
    params = {name: rng.uniform(0.1, 2.0, 4) for name in GAINS}
    memory, seen = pid.init(4), rng.normal(size=(50, 4, 2))
    together = []
    for obs in seen:
        u, memory, _ = pid.act(params, obs, memory)
        together.append(u[:, 0])
    for i in range(4):
        gains = tuple(params[name][i] for name in GAINS)
        alone = run(pid, gains, seen[:, i, 0], seen[:, i, 1])
        assert np.array_equal(np.array(together)[:, i], alone)


def test_the_standard_form_is_the_parallel_one_in_other_words():
    rng = np.random.default_rng(3)
    y, r = rng.normal(size=(2, 60))
    standard = PID(sample_time=TS, form="standard")
    gains = standard.gains({"K": 2.0, "Ti": 4.0 / 3.0, "Td": 0.2, "N": 2.0})
    assert gains == pytest.approx(tuple(GAINS.values()))
    parallel = run(PID(sample_time=TS), tuple(GAINS.values()), y, r)
    np.testing.assert_allclose(run(standard, gains, y, r), parallel, rtol=1e-12)


def test_absent_gains_are_absent_parts():
    assert PID(sample_time=TS).gains({"Kp": 2.0}) == (2.0, 0.0, 0.0, 0.0)
    assert PID(sample_time=TS, form="standard").gains({"K": 2.0}) == (2.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("form", "given", "said"),
    [
        ("parallel", ["kp"], "unknown gain 'kp' of the parallel form; did you mean 'Kp'"),
        ("parallel", ["Kp", "KI"], "unknown gain 'KI'.*did you mean 'Ki'"),
        ("parallel", ["Kp", "K_d"], "unknown gain 'K_d'.*did you mean 'Kd'"),
        ("parallel", ["K", "Ti"], "'K' is a gain of the standard form.*form='standard'"),
        ("parallel", ["Kp", "Ti"], "'Ti' is a gain of the standard form"),
        ("parallel", ["gain"], "unknown gain 'gain'"),
        ("standard", ["Kp", "Ki"], "'Kp' is a gain of the parallel form; expected K, Ti, Td, N"),
        ("standard", ["K", "Ki"], "'Ki' is a gain of the parallel form"),
    ],
)
def test_names_that_have_no_effect_are_refused(form, given, said, tmp_path):
    pid = PID(sample_time=TS, form=form)
    with pytest.raises(ConfigError, match=said):
        pid.act({name: np.ones(1) for name in given}, np.ones((1, 1)), pid.init(1))
    with pytest.raises(ConfigError, match=said):
        export_pid(pid, dict.fromkeys(given, 1.0), tmp_path / "pid.h")


def test_a_controller_around_it_may_have_parameters_of_its_own():
    others = dict.fromkeys(("T1", "T2", "Td", "N", "feedforward"), 1.0)
    assert PID(sample_time=TS).gains({**GAINS, **others}) == tuple(GAINS.values())
    standard = {"K": 2.0, "Ti": 4.0, "Tf": 1.0, "ki_outer": 3.0}
    assert PID(sample_time=TS, form="standard").gains(standard) == (2.0, 0.5, 0.0, 0.0)


def test_anti_windup_shortens_the_overshoot_of_a_saturated_loop():
    def highest(windup):
        pid = PID(sample_time=TS, setpoint=1.0, output_limits=(-1.05, 1.05), anti_windup=windup)
        memory, y, states = pid.init(1), 0.0, []
        for _ in range(1000):
            u, memory = pid.step((2.0, 2.0, 0.0, 0.0), np.array([y]), np.array([1.0]), memory)
            y += TS * (u[0] - y)
            states.append(y)
        return max(states)

    free = highest("none")
    assert highest("clamping") < free - 0.005
    assert highest("back_calculation") < free - 0.005


def test_a_reversed_loop_has_the_same_anti_windup():
    """Gains and limits of the other sign give the outputs of the other sign."""
    rng = np.random.default_rng(6)
    y, r = rng.normal(size=(2, 100)).cumsum(axis=1)
    pid = PID(sample_time=TS, output_limits=(-1.0, 1.0), anti_windup="back_calculation")
    assert pid.tracking_time_of(2.0, 1.0, 16.0) == pytest.approx(4.0)  # sqrt(Kd / Ki)
    assert pid.tracking_time_of(-2.0, -1.0, -16.0) == pytest.approx(4.0)
    reversed_gains = (-2.0, -1.5, -0.4, 0.1)
    np.testing.assert_allclose(
        run(pid, reversed_gains, y, r), -run(pid, tuple(GAINS.values()), y, r), rtol=1e-12
    )


def test_a_bumpless_start_holds_the_output_that_was_there():
    pid = PID(sample_time=TS, initial_output=0.4)
    assert run(pid, tuple(GAINS.values()), [2.0], [1.0])[0] == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"sample_time": 0.0}, "sample_time=0.0: expected seconds above 0"),
        ({"output_limits": (1.0, -1.0)}, r"output_limits=\(1.0, -1.0\): expected \(low, high\)"),
        ({"rate_limit": 0.0}, "rate_limit=0.0"),
        ({"form": "paralel"}, "did you mean 'parallel'"),
        ({"anti_windup": "clamp"}, "did you mean 'clamping'"),
        ({"tracking_time": -1.0}, "tracking_time=-1.0"),
    ],
)
def test_what_cannot_be_is_refused(changes, said):
    with pytest.raises(ConfigError, match=said):
        PID(**{"sample_time": TS, **changes})


LOGGED = 1_000_000
MAIN = """
#include <stdio.h>
#include "{name}"
int main(void)
{{
    pid_state s; double in[2], u;
    pid_init(&s);
    while (fread(in, sizeof(double), 2, stdin) == 2) {{
        u = pid_step(&s, in[0], in[1]);
        fwrite(&u, sizeof(double), 1, stdout);
    }}
    return 0;
}}
"""


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize("windup", ["clamping", "back_calculation"])
def test_the_exported_c_gives_the_same_outputs_over_a_million_steps(tmp_path, windup):
    pid = PID(
        sample_time=TS, b=0.8, c=0.1, output_limits=(-1.0, 1.0), rate_limit=3.0,
        anti_windup=windup, initial_output=0.1,
    )  # fmt: skip
    rng = np.random.default_rng(4)
    # As 1,000 controllers of 1,000 steps here, one after the other there.
    r, y = rng.normal(size=(2, 1000, LOGGED // 1000))
    memory, expected = pid.init(1000), np.empty((1000, LOGGED // 1000))
    for k in range(LOGGED // 1000):
        expected[:, k], memory = pid.step(tuple(GAINS.values()), y[:, k], r[:, k], memory)
    export_pid(pid, GAINS, tmp_path / "gains.h")
    program = (
        MAIN.format(name="gains.h")
        .replace("u = pid_step", "if (n++ % 1000 == 0) pid_init(&s);\n        u = pid_step")
        .replace("double in[2], u;", "double in[2], u; long n = 0;")
    )
    (tmp_path / "main.c").write_text(program)
    build = ["cc", "-O1", "-Wall", "-Wextra", "-Werror", "-o", "replay", "main.c", "-lm"]
    subprocess.run(build, cwd=tmp_path, check=True)
    logged = np.stack([r.ravel(), y.ravel()], axis=1).tobytes()
    done = subprocess.run([tmp_path / "replay"], input=logged, capture_output=True, check=True)
    outputs = np.frombuffer(done.stdout).reshape(expected.shape)
    assert np.abs(outputs - expected).max() <= 1e-12


def test_the_exported_python_gives_the_same_outputs(tmp_path):
    pid = PID(sample_time=TS, output_limits=(-1.0, math.inf), rate_limit=3.0)
    path = export_pid(pid, GAINS, tmp_path / "gains.py")
    names = {}
    exec(path.read_text(), names)
    y, r = np.random.default_rng(5).normal(size=(2, 40))
    outputs = [names["step"](*pair) for pair in zip(r, y, strict=True)]
    assert np.array_equal(outputs, run(pid, tuple(GAINS.values()), y, r))


def test_the_exported_matlab_names_the_gains_in_order(tmp_path):
    text = export_pid(PID(sample_time=TS), GAINS, tmp_path / "gains.m").read_text()
    assert "pid(2.0, 1.5, 0.4, 0.1, 0.05" in text


def test_an_unknown_suffix_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"gains\.txt"):
        export_pid(PID(sample_time=TS), GAINS, tmp_path / "gains.txt")


def test_a_time_of_zero_in_standard_form_is_refused(tmp_path):
    pid = PID(sample_time=TS, form="standard")
    with pytest.raises(ConfigError, match="Ti=0: expected a number above 0"):
        export_pid(pid, {"K": 1.0, "Ti": 0.0}, tmp_path / "pid.h")
    with pytest.raises(ConfigError, match="N=0: expected a number above 0"):
        export_pid(pid, {"K": 1.0, "Td": 1.0, "N": 0}, tmp_path / "pid.h")


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such folder; choose a folder that is there"):
        export_pid(PID(sample_time=TS), GAINS, tmp_path / "nowhere" / "gains.h")
    (tmp_path / "gains.h").mkdir()
    with pytest.raises(ConfigError, match="Is a directory; choose"):
        export_pid(PID(sample_time=TS), GAINS, tmp_path / "gains.h")


def test_gains_that_are_not_finite_are_not_exported(tmp_path):
    with pytest.raises(ConfigError, match="Kp=nan"):
        export_pid(PID(sample_time=TS), {"Kp": math.nan}, tmp_path / "gains.h")
