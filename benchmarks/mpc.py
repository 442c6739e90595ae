"""Speed of several ways to compute the MPC, as ratios within one run: `python -m benchmarks.mpc`.

All ways solve the same problems, ten at a time in turn, so that a busy machine slows all of them
alike. The medians over these tens of CPU time per problem are compared, on one thread, with
parameters from the whole box. The default path takes the ten as environments side by side, as a run
does. States are the starts of episodes or, with `--after`, the states that the same parameters led
to in so many steps. Each way takes a ten once uncounted, then up to eight times, of which the
median counts. In a run its code and memory are in the caches; here another way has just displaced
them.
"""

from __future__ import annotations

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

import argparse
import time
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np

from tests.mpc_tracking.oracle import NonlinearMpc
from zoac.core.seeding import stream
from zoac.mpc.formulation import Layout, build_problem
from zoac.mpc.problem import LinearisedProblem, Solution
from zoac.mpc.solvers.clarabel_qp import _STEP_FRACTIONS, ClarabelSolver
from zoac.mpc.solvers.parameters import write_parameters
from zoac.mpc.solvers.riccati import Riccati
from zoac.mpc.solvers.scaling import units
from zoac.mpc.sqp import MpcOptions
from zoac.tasks.mpc_tracking import MpcTrackingVecEnv, TrackingMpc
from zoac.tasks.mpc_tracking.controller import SPACE

Way = Callable[[slice], object]

ANEW = "CVXPY problem built anew"
PROBLEM_SOLVE = "CVXPY problem.solve(), best formulated"
ONE_QP = "default path, one QP"
STEP = "default path, three linearisations"
STEP_ALONE = "default path, the same, one environment alone"
STRUCTURED = "riccati, three linearisations, ten environments"
IPOPT = "CasADi + IPOPT, built once"


TEN = 10
MAX_COUNTED, ENOUGH_SECONDS = 8, 0.05  # of a ten, for each way


class Recorder(ClarabelSolver):
    """Record the problems it receives."""

    def __init__(self) -> None:
        super().__init__()
        self.problems: list[LinearisedProblem] = []

    def solve(self, problem: LinearisedProblem, robust: bool = False) -> Solution:
        self.problems.append(problem)
        return super().solve(problem, robust)


class Stopwatch:
    """Clarabel's solver object, with the time that its `solve` takes and that of the way to it."""

    def __init__(self, inner: Any) -> None:
        self._inner = inner
        self.inside = self.whole = 0.0
        self.update = inner.update

    def solve(self) -> Any:
        began = time.thread_time()
        answer = self._inner.solve()
        self.inside += time.thread_time() - began
        return answer

    def around(self, way: Way) -> Way:
        """Return `way`, whose time is then added to `whole`."""

        def watched(which: slice) -> None:
            began = time.thread_time()
            way(which)
            self.whole += time.thread_time() - began

        return watched


def solve_built_anew(problem: LinearisedProblem) -> None:
    """Formulate the problem as a textbook does, stage by stage with constants, and solve it."""
    horizon, nx, nu = problem.b.shape[1:]
    x, u = cp.Variable((horizon + 1, nx)), cp.Variable((horizon, nu))
    states, inputs = problem.states[0], problem.inputs[0]
    cost, constraints = 0, [x[0] == states[0]]
    for k in range(horizon):
        error = x[k + 1] - problem.reference[0, k]
        cost += cp.quad_form(error, np.diag(problem.state_weights[0, k]))
        cost += cp.quad_form(u[k], np.diag(problem.input_weights[0, k]))
        step = problem.a[0, k] @ (x[k] - states[k]) + problem.b[0, k] @ (u[k] - inputs[k])
        constraints += [x[k + 1] == states[k + 1] + step]
        constraints += [problem.input_low <= u[k], u[k] <= problem.input_high]
    cp.Problem(cp.Minimize(cost), constraints).solve(solver=cp.CLARABEL)


def problem_solve(problem: LinearisedProblem) -> Callable[[LinearisedProblem], None]:
    """Return `problem.solve()` at its fastest: warm start on, the fast path's settings."""
    layout = Layout.of(problem)
    formulation = build_problem(layout)
    starts = {"dynamics": 0, "weights": layout.dynamics_size}
    values = np.empty((1, layout.dynamics_size + layout.weights_size))
    settings = {
        **dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-10),
        "max_step_fraction": _STEP_FRACTIONS[0],
        "presolve_enable": False,
        "iterative_refinement_enable": False,
        "max_threads": 1,
    }

    def solve(problem: LinearisedProblem) -> None:
        write_parameters(problem, layout, units(problem), values, starts)
        parts = np.split(values[0], [layout.dynamics_size])
        for parameter, part in zip(formulation.parameters.values(), parts, strict=True):
            parameter.value = part
        formulation.problem.solve(solver=cp.CLARABEL, warm_start=True, **settings)

    return solve


def one_by_one(function: Callable[[int], object]) -> Way:
    """Return the way that takes the problems of a slice one after the other."""

    def way(which: slice) -> None:
        for k in range(which.start, which.stop):
            function(k)

    return way


def ways(problems: int, after: int) -> tuple[dict[str, Way], Stopwatch]:
    """Return every way as a function of a slice of problems, and a watch on `ONE_QP`."""
    z = stream(0, "benchmark").uniform(-1.0, 1.0, (problems, SPACE.dimension))
    values, params = SPACE.values(z), SPACE.denormalise(z)
    num_envs = MpcTrackingVecEnv(problems)
    observations = num_envs.reset(seed=0)[0]
    driver = TrackingMpc(Riccati())
    for _ in range(after):
        observations = num_envs.step(driver.act(params, observations, {})[0])[0]

    def act(controller: TrackingMpc) -> Way:
        return lambda which: controller.act(
            {name: value[which] for name, value in params.items()}, observations[which], {}
        )

    recorder, solver = Recorder(), ClarabelSolver()
    record, one_qp = (act(TrackingMpc(s, MpcOptions(linearisations=1))) for s in (recorder, solver))
    one_by_one(lambda k: record(slice(k, k + 1)))(slice(0, problems))
    one_qp(slice(0, TEN))  # compiles
    ((layout, (form, inner)),) = solver._prepared.items()
    watch = Stopwatch(inner[0])
    solver._prepared[layout] = form, [watch, *inner[1:]]
    step = act(TrackingMpc(ClarabelSolver()))
    qps = recorder.problems
    solve = problem_solve(qps[0])
    ipopt = NonlinearMpc(SPACE.names, tolerance=1e-8)
    functions = {
        ANEW: one_by_one(lambda k: solve_built_anew(qps[k])),
        PROBLEM_SOLVE: one_by_one(lambda k: solve(qps[k])),
        ONE_QP: watch.around(one_qp),
        STEP: step,
        STRUCTURED: act(TrackingMpc(Riccati())),
        STEP_ALONE: one_by_one(lambda k: step(slice(k, k + 1))),
        IPOPT: one_by_one(lambda k: ipopt.plan(values[k], observations[k])),
    }
    return functions, watch


def seconds_of(function: Way, which: slice) -> float:
    """Return the CPU seconds that `function` typically takes for the problems of a slice."""
    function(which)  # not counted: the way before left cold caches
    counted: list[float] = []
    while len(counted) < MAX_COUNTED and sum(counted) < ENOUGH_SECONDS:
        began = time.thread_time()
        function(which)
        counted.append(time.thread_time() - began)
    return float(np.median(counted))


def measure(functions: dict[str, Way], problems: int) -> dict[str, float]:
    """Return each way's median CPU seconds per problem."""
    tens = [slice(first, first + TEN) for first in range(0, problems, TEN)]
    spent = [[seconds_of(way, ten) / TEN for way in functions.values()] for ten in tens]
    return dict(zip(functions, np.median(spent, axis=0).tolist(), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tens", type=int, default=7, help="how many times ten problems")
    parser.add_argument("--after", type=int, default=0, help="steps in closed loop; default: 0")
    options = parser.parse_args()
    problems = TEN * options.tens
    functions, watch = ways(problems, options.after)
    median = measure(functions, problems)
    for name, value in median.items():
        print(f"{name:40s} {value * 1e6:9.0f} us")
    print(f"one QP against problem.solve()       {median[PROBLEM_SOLVE] / median[ONE_QP]:6.1f} x")
    print(f"one QP against built anew            {median[ANEW] / median[ONE_QP]:6.1f} x")
    print(f"three linearisations against IPOPT   {median[IPOPT] / median[STEP]:6.1f} x")
    print(f"riccati against IPOPT                {median[IPOPT] / median[STRUCTURED]:6.1f} x")
    print(f"riccati against Clarabel             {median[STEP] / median[STRUCTURED]:6.1f} x")
    print(f"one QP outside Clarabel's solve()    {1 - watch.inside / watch.whole:6.1%}")


if __name__ == "__main__":
    main()
