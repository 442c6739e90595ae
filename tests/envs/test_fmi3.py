"""An FMU of FMI 3.0, built here in C, against its Python original."""

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy  # of the extra `dev`
import pytest

from tests import commands
from tests.envs.test_fmu import STEP, STEPS, Mass, fmu, pd, tuned
from zoac.core.errors import ConfigError, EnvironmentFailure
from zoac.tasks.user_task import user_task

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="builds an FMU with gcc on Linux")

SOURCE = r"""
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

typedef struct { double v[5]; } Mass;  /* time, mass, force, position, speed */
static const Mass START = {{0.0, 1.0, 0.0, 1.0, 0.0}};
#define M ((Mass *)instance)

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[],
    size_t n, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback update) {
  if (strcmp(token, "{mass}")) return NULL;
  Mass *mass = malloc(sizeof(Mass));
  *mass = START;
  return mass;
}
void fmi3FreeInstance(fmi3Instance instance) {
  if (M->v[1] > 90.0) abort();  /* after a fatal error, which forbids every call */
  free(instance);
}
fmi3Status fmi3Reset(fmi3Instance instance) { *M = START; return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(
    fmi3Instance instance, fmi3Boolean t, fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean s,
    fmi3Float64 stop) { M->v[0] = start; return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) { return fmi3OK; }
fmi3Status fmi3GetFloat64(
    fmi3Instance instance, const fmi3ValueReference r[], size_t n, fmi3Float64 values[],
    size_t nv) { for (size_t i = 0; i < n; i++) values[i] = M->v[r[i]]; return fmi3OK; }
fmi3Status fmi3SetFloat64(
    fmi3Instance instance, const fmi3ValueReference r[], size_t n, const fmi3Float64 values[],
    size_t nv) { for (size_t i = 0; i < n; i++) M->v[r[i]] = values[i]; return fmi3OK; }
fmi3Status fmi3DoStep(
    fmi3Instance instance, fmi3Float64 t, fmi3Float64 step, fmi3Boolean no, fmi3Boolean *event,
    fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
  double *v = M->v;
  if (v[1] > 90.0) return fmi3Fatal;
  if (v[1] > 50.0) return fmi3Error;
  v[4] += step * (v[2] / v[1] - 0.1 * v[4]);
  v[3] += step * v[4];
  *event = *early = fmi3False;
  *terminate = v[3] > 30.0;
  *last = v[0] = t + step;
  return fmi3OK;
}
fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state) {
  *state = malloc(sizeof(Mass));
  memcpy(*state, instance, sizeof(Mass));
  return fmi3OK;
}
fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state) {
  memcpy(instance, state, sizeof(Mass));
  return fmi3OK;
}
fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state) {
  free(*state);
  *state = NULL;
  return fmi3OK;
}
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size) {
  *size = sizeof(Mass);
  return fmi3OK;
}
fmi3Status fmi3SerializeFMUState(
    fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size) {
  memcpy(bytes, state, size);
  return fmi3OK;
}
fmi3Status fmi3DeserializeFMUState(
    fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state) {
  *state = malloc(sizeof(Mass));
  memcpy(*state, bytes, size);
  return fmi3OK;
}
"""
DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="mass" instantiationToken="{mass}">
  <CoSimulation modelIdentifier="mass" canGetAndSetFMUState="true" canSerializeFMUState="true"
                canHandleVariableCommunicationStepSize="true"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>
    <Float64 name="mass" valueReference="1" causality="parameter" variability="tunable"
             start="1.0"/>
    <Float64 name="force" valueReference="2" causality="input" start="0.0"/>
    <Float64 name="position" valueReference="3" causality="output"/>
    <Float64 name="speed" valueReference="4" causality="output"/>
    <Float64 name="row" valueReference="5" causality="output"><Dimension start="2"/></Float64>
    <Int32 name="count" valueReference="6" causality="output"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3"/><Output valueReference="4"/>
    <Output valueReference="5"/><Output valueReference="6"/>
  </ModelStructure>
</fmiModelDescription>
"""


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmi3")
    (folder / "mass.c").write_text(SOURCE)
    headers = Path(fmpy.__file__).parent / "c-code"
    names = re.findall(r"FMI3_Export \w+\s+(\w+);", (headers / "fmi3Functions.h").read_text())
    # The standard asks for every function, also for those of what the FMU cannot do.
    others = [f"int {name}(void) {{ return 3; }}\n" for name in names if f" {name}(" not in SOURCE]
    (folder / "others.c").write_text("".join(others))
    subprocess.run(["gcc", "-shared", "-fPIC", "-ffp-contract=off", f"-I{headers}", "mass.c",
                    "others.c", "-o", "mass.so"], cwd=folder, check=True)  # fmt: skip
    with zipfile.ZipFile(folder / "mass.fmu", "w") as made:
        made.writestr("modelDescription.xml", DESCRIPTION)
        made.write(folder / "mass.so", f"binaries/{fmpy.platform_tuple}/mass.so")
    return folder / "mass.fmu"


def test_it_tunes_to_the_gains_and_costs_of_the_original(path):
    options = {"tuner": "zoac_plus", "vary": {"mass": (0.5, 4.0)}}
    original = tuned(Mass, max_episode_steps=STEPS, **options)
    found = tuned(lambda: fmu(path), **options)
    assert found.parameters == pytest.approx(original.parameters, abs=1e-9)
    assert found.cost_per_episode == pytest.approx(original.cost_per_episode, abs=1e-9)
    assert found.record["env_restarts"] == 0


def test_its_state_is_saved_and_restored(path):
    task = user_task(env=lambda: fmu(path), controller=pd, space={"kp": (0, 9), "kd": (0, 9)})
    assert task.save_fault is None


@pytest.mark.parametrize("mass", [60.0, 95.0])  # an error, and a fatal one
def test_a_step_that_fails_is_an_episode_that_fails(mass, path):
    env = fmu(path)
    env.mass = mass
    env.reset(seed=0)
    with pytest.raises(EnvironmentFailure, match="the FMU's step failed: fmi3DoStep failed"):
        env.step([0.0])
    env.mass = 1.0
    env.reset(seed=0)
    assert env.step([0.0])[0].tolist() == [1.0, 0.0]


def test_an_fmu_that_asks_for_the_end_has_failed(path):
    env = fmu(path)
    env.reset(seed=0)
    with pytest.raises(EnvironmentFailure, match="asks for the end of the simulation at"):
        for _ in range(1000):
            env.step([5.0 / STEP])


FORKS = """
import os, sys
from tests import commands
from tests.envs.test_fmu import fmu
env = fmu(sys.argv[1])
env.reset(seed=0)
(folder,) = os.listdir(os.environ["TMPDIR"])
if (child := os.fork()) == 0:
    env = None
    sys.exit()
assert os.waitpid(child, 0)[1] == 0
assert os.listdir(os.environ["TMPDIR"]) == [folder]
print(env.step([0.0])[0].tolist())
"""


def test_a_fork_leaves_the_instance_alone_and_the_end_leaves_no_files(path, tmp_path):
    done = commands.run("-c", FORKS, path, cwd=Path(__file__).parents[2],
                        env={**os.environ, "TMPDIR": str(tmp_path)})  # fmt: skip
    assert (done.returncode, done.stdout) == (0, "[1.0, 0.0]\n"), done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["row", "count"])
def test_arrays_and_whole_numbers_are_refused(name, path):
    with pytest.raises(ConfigError, match=f"mass.fmu has no real variable '{name}'"):
        fmu(path, observations=[name])
