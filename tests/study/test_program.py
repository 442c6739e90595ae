"""An external program as a cost: crashes, hangs and garbage are failures with a reason."""

import json
import math
import os
import signal
import sys
import time

import numpy as np
import pytest

import zoac
from tests import commands
from zoac.core.errors import ConfigError
from zoac.study.program import MAX_TIMEOUT, ProgramError

GOOD = """
import json, sys
p = json.load(open(sys.argv[1]) if len(sys.argv) > 1 else sys.stdin)
print("simulating")
print(json.dumps({"cost": p["kp"] ** 2, "metrics": {"energy": 1.0}}))
"""


def python(code, *arguments, **options):
    return zoac.program([sys.executable, "-S", "-E", "-c", code, *arguments], **options)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("arguments", [(), ("{file}",)])
def test_parameters_go_in_and_a_cost_comes_out(arguments):
    assert python(GOOD, *arguments)({"kp": 3.0}) == {"cost": 9.0, "metrics": {"energy": 1.0}}


@pytest.mark.parametrize(
    ("code", "says"),
    [
        ("import sys; print('no licence', file=sys.stderr); sys.exit(3)",
         r"ended with exit status 3: its last lines\n  no licence"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "was ended by SIGSEGV"),
        ("print('cost: 3')", r"did not answer with a JSON object: its last lines\n  cost: 3"),
        ("print('\\x1b[31mred\\tegg')", r"with a JSON object: its last lines\n  \?\[31mred\tegg$"),
        ("print('[1]')", "did not answer with a JSON object"),
        ("", "did not answer with a JSON object$"),
        ("print('warming up', flush=True); import time; time.sleep(60)",
         r"did not end within 0\.5 s: its last lines\n  warming up"),
        ("import sys\nfor i in range(99): print('line', i, file=sys.stderr)\nsys.exit(1)",
         r"last lines\n  line 94\n  line 95\n  line 96\n  line 97\n  line 98$"),
    ],
)  # fmt: skip
def test_a_failure_says_what_the_program_said(code, says):
    with pytest.raises(ProgramError, match=says):
        python(code, timeout=0.5)({"kp": 1.0})


def test_a_hang_is_killed_with_all_its_children(tmp_path):
    code = f"""
import subprocess, sys, os, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
open({str(tmp_path / "pids")!r}, "w").write(f"{{os.getpid()}} {{child.pid}}")
time.sleep(60)
"""
    begun = time.monotonic()
    with pytest.raises(ProgramError, match="did not end within 1 s"):
        python(code, timeout=1.0)({})
    assert time.monotonic() - begun < 20
    pids = [int(pid) for pid in (tmp_path / "pids").read_text().split()]
    time.sleep(0.1)
    assert [alive(pid) for pid in pids] == [False, False]


def test_a_child_that_outlives_the_program_is_killed_too(tmp_path):
    code = f"""
import subprocess, sys
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"],
                         stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
open({str(tmp_path / "pid")!r}, "w").write(str(child.pid))
print('{{"cost": 1}}')
"""
    assert python(code, timeout=30)({}) == {"cost": 1}
    time.sleep(0.1)
    assert not alive(int((tmp_path / "pid").read_text()))


def test_retries_repeat_what_failed(tmp_path):
    code = f"""
import os, sys
count = len(os.listdir({str(tmp_path)!r}))
open(os.path.join({str(tmp_path)!r}, str(count)), "w")
if count < 2: sys.exit("not yet")
print('{{"cost": 1}}')
"""
    assert python(code, retries=2)({}) == {"cost": 1}
    assert len(os.listdir(tmp_path)) == 3
    for name in os.listdir(tmp_path):
        os.remove(tmp_path / name)
    with pytest.raises(ProgramError, match="not yet"):
        python(code, retries=1)({})
    assert len(os.listdir(tmp_path)) == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([],), "expected one such as"),
        ((3,), r"program: 3 is no command; expected one such as \['./simulate', '--quick'\]"),
        (("./simulate 'a",), "is no command; expected one such as"),
        ((["./simulate"],), "'./simulate' is not found or may not be executed"),
        (("no-such-program --quick",), "'no-such-program' is not found"),
    ],
)
def test_a_program_that_is_not_there_is_refused_at_once(arguments, says):
    with pytest.raises(ConfigError, match=says):
        zoac.program(*arguments)


@pytest.mark.parametrize(
    "options",
    [{"timeout": 0}, {"timeout": math.inf}, {"timeout": 1e7}, {"retries": -1}, {"retries": 1.5},
     {"cwd": "/no/such/folder"}, {"cwd": 3}],
)  # fmt: skip
def test_options_that_cannot_be_used_are_refused(options):
    with pytest.raises(ConfigError, match=next(iter(options)) + "|folder"):
        python(GOOD, **options)


def test_the_longest_time_limit_can_be_waited_for():
    assert python(GOOD, timeout=MAX_TIMEOUT)({"kp": 1.0})["cost"] is not None


def test_a_count_of_retries_may_be_of_numpy():
    assert python(GOOD, retries=np.int64(3)).retries == 3


def test_a_program_runs_in_its_folder(tmp_path):
    script = tmp_path / "simulate"
    script.write_text("#!/bin/sh\nprintf '{\"cost\": %d}' $(ls | wc -l)\n")
    script.chmod(0o755)
    assert zoac.program("./simulate", cwd=tmp_path)({}) == {"cost": 1}


def test_experiments_run_side_by_side_and_failures_teach(tmp_path):
    code = """
import json, sys, time
p = json.load(sys.stdin)
if p["kp"] > 15: sys.exit("too stiff")
begun = time.monotonic()
time.sleep(0.2)
metrics = {"begun": begun, "ended": time.monotonic()}
print(json.dumps({"cost": (p["kp"] - 3) ** 2, "metrics": metrics}))
"""
    result = zoac.tune(cost=python(code, timeout=30), space={"kp": (0.0, 20.0)}, experiments=12,
                       tuner="random", workers=4, folder=tmp_path, quiet=True)  # fmt: skip
    runs = result.history.dropna(subset=["begun"]).sort_values("begun")
    assert (runs["begun"].iloc[1:].to_numpy() < runs["ended"].iloc[:-1].to_numpy()).any()
    assert result.record["experiments"] == 12
    assert result.record["failures"] > 0
    assert result.record["first_failure"].endswith("too stiff")
    assert result.parameters["kp"] < 15


def test_ctrl_c_ends_the_programs_and_the_same_call_goes_on(tmp_path):
    hangs = f"""
import os, time
open({str(tmp_path / "pids")!r}, "a").write(str(os.getpid()) + "\\n")
time.sleep(60)
"""
    script = f"""
import zoac
zoac.tune(cost=zoac.program({[sys.executable, "-S", "-E", "-c", hangs]!r}), experiments=8,
          space={{"kp": (0.0, 20.0)}}, tuner="random", workers=2, folder="rig")
"""
    running, pids = commands.Started("-c", script, cwd=tmp_path), tmp_path / "pids"
    while not pids.exists() or pids.read_text().count("\n") < 2:
        time.sleep(0.02)
        assert running.poll() is None, running.communicate()
    running.send_signal(signal.SIGINT)
    _, errors = running.communicate(timeout=20)
    assert "stopped after 0 of 8 experiments; the same call goes on" in errors
    time.sleep(0.1)
    assert not any(alive(int(pid)) for pid in pids.read_text().split())
    calls = []
    zoac.tune(cost=lambda p: calls.append(p) or p["kp"], experiments=8, workers=2, quiet=True,
              space={"kp": (0.0, 20.0)}, tuner="random", folder=tmp_path / "rig")  # fmt: skip
    assert len(calls) == 8
    journal = (tmp_path / "rig/journal.jsonl").read_text()
    rows = [json.loads(line) for line in journal.splitlines()]
    assert [row["number"] for row in rows if row["kind"] == "asked"] == list(range(1, 9))
    assert {row["kind"] for row in rows} == {"asked", "told"}
