import numpy as np
import pytest
from PIL import Image

from tests.analysis.folders import GAINS, NOMINAL, PID, write_run
from zoac.analysis import landscape, trajectories
from zoac.analysis.data import replay
from zoac.analysis.data.load import load, read
from zoac.analysis.data.selection import chosen, median_run
from zoac.analysis.figures import film, style
from zoac.core.errors import ConfigError, RunFolderError
from zoac.core.parameters import Parameter, ParameterSpace, choice
from zoac.rollout.engine import RolloutEngine
from zoac.rollout.evaluation import evaluation_proposals
from zoac.rollout.task import Task
from zoac.tasks.pid_acc import PidAcc


@pytest.fixture
def task():
    return PidAcc(max_episode_steps=40)


def test_a_task_is_rebuilt_with_the_options_of_its_run(tmp_path):
    task = replay.rebuild(read(write_run(tmp_path)))
    assert task.make_env(1).max_episode_steps == PID["max_episode_steps"]


def test_a_task_that_cannot_be_rebuilt_is_one_message(tmp_path):
    folder = write_run(tmp_path, config={"task": {"_target_": "zoac.tasks.nowhere.Task"}})
    with pytest.raises(RunFolderError, match="its task cannot be built again"):
        replay.rebuild(read(folder))


def test_the_demonstration_is_the_tasks_own(task):
    (segment,) = replay.demonstrate(task, [GAINS])
    env, controller = task.make_env(1), task.make_controller()
    observation, _ = env.reset(options={"demonstration": True})
    params = task.space.denormalise(task.space.normalise(GAINS)[None])
    for step in range(segment.length):
        np.testing.assert_array_equal(segment.observations[step], observation[0])
        action, _, _ = controller.act(params, observation, {})
        observation, *_ = env.step(action)
    assert segment.length == 40


class Failing(PidAcc):
    """A task whose controller always fails."""

    failure_penalty = 7.0

    def make_controller(self):
        controller = super().make_controller()

        class Fails(type(controller)):
            def act(self, *given):
                raise ZeroDivisionError

        return Fails()


def test_a_controller_that_fails_costs_in_the_demonstration_what_it_cost_in_the_run():
    (segment,) = replay.demonstrate(Failing(max_episode_steps=40), [GAINS])
    assert segment.costs.tolist() == [7.0]


def test_costs_are_those_of_the_evaluation(task):
    points = task.space.normalise({name: np.array([GAINS[name], NOMINAL[name]]) for name in GAINS})
    group = RolloutEngine(task, range(3), [0] * 3)
    direct = [s.costs.sum() for s in group.rollout(evaluation_proposals(points[1], 3, seed=7))]
    np.testing.assert_array_equal(replay.costs(task, points, 3, seed=7)[1], direct)


def test_environments_may_be_fewer_than_episodes(task, monkeypatch):
    points = np.zeros((3, 4))
    points[:, 0] = (-1.0, 0.0, 1.0)
    wide = replay.costs(task, points, 3, seed=0)
    monkeypatch.setattr(replay, "MAX_ENVS", 2)
    np.testing.assert_array_equal(replay.costs(task, points, 3, seed=0), wide)


def test_a_slice_passes_through_the_tuned_parameters(task, tmp_path):
    run = read(write_run(tmp_path))
    (part,) = landscape.sliced(task, run, ["Kp"], points=11, episodes=2)
    np.testing.assert_allclose(part.values, np.linspace(0, 10, 11))
    tuned = replay.costs(task, task.space.normalise(run.outcome["parameters"])[None], 2, seed=0)
    np.testing.assert_allclose(part.costs[1], tuned[0])  # Kp was tuned to 1


@pytest.mark.parametrize("lost", [np.nan, np.inf])
def test_the_least_cost_of_a_slice_is_a_finite_one(lost):
    part = landscape.Slice(
        Parameter("Kp", 0.0, 2.0), np.arange(3.0), np.array([[lost, 1.0], [4.0, 4.0], [2.0, 2.0]])
    )
    axes = style.blank(style.PAGE, 2.0).subplots()
    landscape._draw_cost(axes, part)
    _, star = axes.get_lines()
    assert star.get_xydata().tolist() == [[2.0, 2.0]]
    assert axes.get_xlim() == pytest.approx((1.8, 4.2))


def test_a_slice_without_a_finite_cost_is_drawn_empty():
    part = landscape.Slice(Parameter("Kp", 0.0, 2.0), np.arange(3.0), np.full((3, 2), np.nan))
    axes = style.blank(style.PAGE, 2.0).subplots()
    landscape._draw_cost(axes, part)
    assert [line.get_label() for line in axes.get_lines()] == ["Mean cost"]


def test_an_unknown_parameter_is_answered_with_those_there_are(task, tmp_path):
    with pytest.raises(ConfigError, match="unknown parameter 'Kpp'; did you mean 'Kp'"):
        landscape.sliced(task, read(write_run(tmp_path)), ["Kpp"], 2, 2)


def test_without_a_parameter_that_is_a_number_there_is_no_landscape(tmp_path, monkeypatch, capsys):
    chosen_only = PidAcc(max_episode_steps=2)
    chosen_only.space = ParameterSpace([choice("better", ["speed", "gap"])])
    monkeypatch.setattr(replay, "rebuild", lambda run: chosen_only)
    run = write_run(tmp_path / "runs", gains={"better": "gap"}, evaluations=())
    assert landscape.main([str(run), "--out", str(tmp_path / "out")]) == 1
    assert "all are choices (better)" in capsys.readouterr().err


def test_the_run_shown_is_the_median_one(sweep):
    assert [(run.method.tuner, run.seed) for run in chosen(load(sweep))] == [
        ("zoac", 2),
        ("bo", 2),
        ("cmaes", 2),
        ("nominal", 0),
    ]


def test_of_two_runs_the_better_is_the_lower_median(tmp_path):
    runs = [read(write_run(tmp_path, seed=s, costs=(c, c))) for s, c in enumerate((5.0, 3.0))]
    assert median_run(runs).seed == 1


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (4, 3, 2, 1, 0), (1, 0, 3, 4, 2)])
def test_a_run_without_a_finite_cost_counts_as_the_worst(tmp_path, order):
    means = (3.0, None, 1.0, 2.0, 5.0)
    runs = [read(write_run(tmp_path, seed=s, result={"cost_mean": means[s]})) for s in order]
    assert median_run(runs).cost_mean == 3.0


def test_asking_for_a_run_that_is_not_there(sweep):
    with pytest.raises(RunFolderError, match="no finished run with tuner 'es' with seed 3"):
        chosen(load(sweep), "es", 3)


class Anybody(PidAcc):
    """A task that says nothing about its figures."""

    traces = Task.traces
    draw = Task.draw


def test_a_task_without_figures_shows_observations_actions_and_cost():
    task = Anybody(max_episode_steps=5)
    task.signals = {}
    (segment,) = replay.demonstrate(task, [GAINS])
    traces = task.traces(segment)
    assert [trace.title for trace in traces][-3:] == ["Observation 9", "Action 0", "Cost"]
    np.testing.assert_array_equal(traces[-1].y, segment.costs)


@pytest.mark.parametrize(
    ("command", "options"),
    [(trajectories, []), (landscape, ["--parameters", "Kp", "--points", "3", "--episodes", "2"])],
)
def test_the_same_runs_give_the_same_pictures(command, options, sweep, tmp_path):
    for out in ("a", "b"):
        arguments = [str(sweep), "--out", str(tmp_path / out), "--format", "svg", *options]
        assert command.main(arguments) == 0
    (picture,) = (tmp_path / "a").iterdir()
    assert picture.read_bytes() == (tmp_path / "b" / picture.name).read_bytes()


def test_several_tasks_must_be_told_apart(sweep, tmp_path, capsys):
    write_run(sweep, task="mpc_tracking")
    assert trajectories.main([str(sweep), "--out", str(tmp_path)]) == 1
    expected = "error: runs of several tasks; choose with --task: mpc_tracking, pid_acc\n"
    assert capsys.readouterr().err == expected


def test_a_film_shows_before_and_after(sweep, tmp_path, monkeypatch):
    monkeypatch.setattr(film, "FRAMES", 3)
    monkeypatch.setattr(film, "HOLD", 1)
    path = tmp_path / "docs" / "loop.gif"
    assert trajectories.main([str(sweep), "--tuner", "zoac", "--animate", str(path)]) == 0
    with Image.open(path) as picture:
        assert picture.n_frames == 3
        first = np.asarray(picture.convert("RGB")).copy()
        picture.seek(2)
        last = np.asarray(picture.convert("RGB"))
    for half in (slice(0, 400), slice(400, 800)):
        assert (first[:, half] != last[:, half]).any()


def test_the_first_picture_of_a_film_shows_both_courses(task):
    segments = replay.demonstrate(task, [{**GAINS, "Ki": 9.0}, GAINS])
    picture = next(iter(film.frames(task, segments, ("Before", "After")))).astype(int)
    plot = picture[225:310, 80:]  # below the scenes
    red_less_blue = plot[..., 0] - plot[..., 2]
    for course in (red_less_blue > 25, red_less_blue < -25):  # warm before, blue after
        columns = np.flatnonzero(course.any(axis=0))
        assert np.ptp(columns) > 500


def test_a_film_needs_to_know_the_beginning(tmp_path):
    run = read(write_run(tmp_path, evaluations=[(500, 10.0)]))
    with pytest.raises(RunFolderError, match="there is no 'before tuning' to show"):
        film.write(tmp_path / "loop.gif", run)


def test_films_come_in_two_formats(tmp_path, monkeypatch):
    run = read(write_run(tmp_path))
    with pytest.raises(ConfigError, match=r"cannot write a film as '.avi'; .*known: .gif, .mp4"):
        film.write(tmp_path / "loop.avi", run)
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(ConfigError, match="needs ffmpeg"):
        film.write(tmp_path / "loop.mp4", run)


def test_a_film_ends_where_the_loop_has_settled(task):
    calm = PidAcc(max_episode_steps=1000)
    (segment,) = replay.demonstrate(calm, [NOMINAL])
    # The demonstration's preceding car drives steadily from step 271 on.
    assert 271 < replay.settled(calm, [segment]) < 700


def test_a_limit_that_is_in_view_has_an_entry_and_dashes_of_its_own():
    task = PidAcc(max_episode_steps=300)
    wild = {"k": 0.3, "Kp": 7.0, "Ki": 9.0, "Kd": 6.5}
    segments = replay.demonstrate(task, [GAINS, wild])
    looks = {"Before": style.BEFORE, "After": style.AFTER}
    loops = [
        trajectories.Loop(name, look, segment, task.traces(segment))
        for (name, look), segment in zip(looks.items(), segments, strict=True)
    ]
    figure = trajectories.draw(task, loops, "")
    shown = dict(
        zip(
            [text.get_text() for text in figure.legends[0].get_texts()],
            [line.get_linestyle() for line in figure.legends[0].get_lines()],
            strict=True,
        )
    )
    assert list(shown)[-1] == "Limit"
    assert shown["Limit"] == "-."
    assert "-." not in [dashes for name, dashes in shown.items() if name != "Limit"]
