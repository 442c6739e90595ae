"""`zoac.tune(cost=...)` calls the function as often as it was told, and nothing else."""

import threading

import pytest

import zoac
from zoac.core.errors import ConfigError, NothingWorksError
from zoac.study.study import Study

SPACE = {"kp": {"low": 0.0, "high": 20.0, "baseline": 10.0}, "ki": (0.0, 5.0, "linear"), "ts": 0.1}
BASELINE = {"ki": 4.0}


class Counted:
    """A cost that counts its calls."""

    def __init__(self, function=None):
        self.calls, self._mutex = [], threading.Lock()
        self._function = function or (lambda p: (p["kp"] - 3.0) ** 2 + (p["ki"] - 1.0) ** 2)

    def __call__(self, parameters):
        with self._mutex:
            self.calls.append(parameters)
        return self._function(parameters)


def tune(cost, **options):
    given = {"space": SPACE, "baseline": BASELINE, "experiments": 60, "quiet": True}
    return zoac.tune(cost=cost, **{**given, **options})


@pytest.mark.parametrize(
    ("tuner", "workers", "acceptance_test"),
    [("random", 3, 0.2), ("cmaes", 1, None), ("cmaes_full", 3, 0.2), ("es", 1, 0.25)],
)
def test_sixty_experiments_are_sixty_calls(tuner, acceptance_test, workers):
    cost = Counted()
    result = tune(cost, tuner=tuner, acceptance_test=acceptance_test, workers=workers)
    assert len(cost.calls) == 60
    first = cost.calls[:1] if workers == 1 else cost.calls  # one worker may overtake another
    assert {"kp": 10.0, "ki": 4.0, "ts": 0.1} in first
    assert result.record["experiments"] == 60
    assert result.baseline_cost_mean == 58.0
    assert result.cost_mean <= 58.0
    assert ("acceptance_test" in result.record) == (acceptance_test is not None)


def test_few_experiments_of_few_parameters_are_bayesian_optimisation():
    result = tune(Counted(), experiments=16)
    assert result.record["tuner"] == "bo"
    assert result.cost_mean < 1.0
    assert result.parameters["ts"] == 0.1
    assert Study(SPACE, baseline=BASELINE, experiments=16, workers=2).settings.tuner == "cmaes"
    of_one = tune(lambda p: p["kp"], space={"kp": (0, 1)}, baseline=None, workers=2)
    assert of_one.record["tuner"] == "nevergrad"
    assert of_one.cost_mean < 0.1


def test_a_dict_of_cost_metrics_and_constraints(tmp_path):
    def cost(p):
        return {"cost": p["kp"], "metrics": {"energy": 2.0 * p["kp"]},
                "constraints": {"overshoot": 10.0 - p["kp"]}}  # fmt: skip

    result = tune(cost, constraints={"overshoot": 4.0}, tuner="cmaes", folder=tmp_path)
    assert 6.0 <= result.parameters["kp"] < 7.0
    assert result.record["energy"] == 2.0 * result.parameters["kp"]
    assert set(Study(folder=tmp_path).history["energy"]) != {2.0}


def test_exceptions_are_failures_and_the_first_reason_is_kept():
    def cost(p):
        if p["ki"] > 2.0:
            raise RuntimeError("unstable")
        return p["kp"]

    result = tune(Counted(cost), tuner="random")
    assert result.record["failures"] > 10
    assert result.record["first_failure"] == "RuntimeError: unstable"
    assert result.parameters["ki"] <= 2.0


def test_an_answer_that_failed_in_one_of_its_experiments_is_told():
    seen = []

    def cost(p):
        seen.append(p)
        if seen.count(p) == 2:
            raise RuntimeError("unstable")
        return 0.0 if p["kp"] == 10.0 else 1.0

    result = tune(cost, tuner="cmaes", acceptance_test=0.25)
    again = next(k for k, p in enumerate(seen, start=1) if k > 1 and p == seen[0])
    (told,) = result.warnings
    assert told.startswith("The answer failed in 1 of its ")
    assert told.endswith(f"the first is experiment {again}.")


def test_a_failure_without_a_reason_does_not_break_the_last_lines(tmp_path, capsys):
    study = Study(SPACE, tmp_path, experiments=3, baseline=BASELINE, tuner="random")
    study.tell(study.ask(), failed="")
    zoac.tune(cost=Counted(), space=SPACE, experiments=3, baseline=BASELINE, tuner="random",
              folder=tmp_path)  # fmt: skip
    assert "failures: 1, the first: no reason given" in capsys.readouterr().out


def test_a_baseline_that_failed_at_first_has_the_cost_of_the_acceptance_test(capsys):
    def cost(p):
        if len(cost.calls) == 1:
            raise RuntimeError("not warm yet")
        return 10.0 - p["kp"] + len(cost.calls) / 100.0

    cost = Counted(cost)
    result = tune(cost, tuner="cmaes_full", acceptance_test=0.2, quiet=False)
    measured = result.record["acceptance_test"]["baseline_cost_mean"]
    assert result.baseline_cost_mean == pytest.approx(measured)
    said = capsys.readouterr().out
    assert f"; baseline values: cost {measured:.6g}\n" in said
    assert "acceptance test: the tuned values beat the baseline values: in 9 pairs of" in said


@pytest.mark.parametrize(
    ("answer", "says"),
    [(None, "the cost is None, expected a number"), ({"Cost": 1.0}, "the answer has an unknown"),
     (float("inf"), "the cost is inf"),
     ({"cost": 1.0, "metrics": {"wall_seconds": 7.0}}, "metric 'wall_seconds': results have")],
)  # fmt: skip
def test_ten_failures_at_the_start_stop_it_with_the_reason(answer, says):
    for workers in (1, 3):
        cost = Counted(lambda p: answer)
        with pytest.raises(NothingWorksError, match=f"each of the first 10 .*: {says}"):
            tune(cost, tuner="random", workers=workers)
        assert 10 <= len(cost.calls) < 10 + workers


def test_a_run_that_stopped_goes_on_in_its_folder(tmp_path):
    given = {"tuner": "cmaes", "experiments": 30}
    whole = tune(Counted(), folder=tmp_path / "whole", **given)

    def stops(p):
        if len(stopping.calls) == 20:
            raise KeyboardInterrupt
        return (p["kp"] - 3.0) ** 2 + (p["ki"] - 1.0) ** 2

    stopping, rest, again = Counted(stops), Counted(), Counted()
    with pytest.raises(zoac.Interrupted, match="stopped after 19 of 30 experiments") as stopped:
        tune(stopping, folder=tmp_path / "parts", **given)
    assert stopped.value.result.finished is False
    assert stopped.value.result.parameters in stopping.calls
    result = tune(rest, folder=tmp_path / "parts", **given)
    assert len(rest.calls) == 11
    assert rest.calls[0] == stopping.calls[-1]
    assert result.parameters == whole.parameters
    assert tune(again, folder=tmp_path / "parts", **given).parameters == whole.parameters
    assert again.calls == []


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"budget": 500}, "has no option 'budget'"),
        ({"env": "Pendulum-v1"}, "has no option 'env'"),
        ({"experiment": 5}, "has no option 'experiment'.*did you mean 'experiments'"),
        ({"space": None}, "needs a space"),
        ({"tuner": "zoac_plus"}, "single steps"),
    ],
)
def test_options_of_simulated_episodes_are_refused(options, says):
    with pytest.raises(ConfigError, match=says):
        tune(Counted(), **options)


def test_workers_need_a_cost():
    with pytest.raises(ConfigError, match="belong to cost="):
        zoac.tune(task="pid_acc", workers=2)
    with pytest.raises(ConfigError, match="expected a function of the parameters"):
        tune("./simulate")
