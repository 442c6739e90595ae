"""Rules are kept, collisions are noticed, discrete parameters arrive."""

import numpy as np
import pytest

import zoac
from zoac.analysis import landscape, report
from zoac.analysis.figures import style
from zoac.tasks.lane_change import LaneChange, LaneChangeVecEnv, RuleBasedDriver
from zoac.tasks.lane_change.plant import CAR, COLLISION_COST, RING

NOMINAL = {
    name: np.array([float(value) if name != "better" else 0.0])
    for name, value in LaneChange.baseline.items()
}
# v, gap, away, next gap, next away, behind, receding, waited
GOOD = np.array([[20.0, 25.0, -1.0, 50.0, 5.0, 50.0, 0.0, 9.0]])


def changes(obs, **params):
    given = {**NOMINAL, **{k: np.array([float(v)]) for k, v in params.items()}}
    return bool(RuleBasedDriver().act(given, obs, {})[0][0, 1])


def test_it_changes_where_every_rule_agrees_and_not_where_one_forbids():
    assert changes(GOOD)
    for column, value in ((3, 29.0), (5, 29.0), (6, -4.0), (7, 4.0), (4, 0.5)):
        bad = GOOD.copy()
        bad[0, column] = value
        assert not changes(bad), column


def test_the_choice_decides_what_is_compared():
    by_speed_only = GOOD.copy()
    by_speed_only[0, 1] = 60.0  # the own gap is larger than the next
    assert changes(by_speed_only)
    assert not changes(by_speed_only, better=1)


def test_a_collision_ends_the_episode_and_costs():
    env = LaneChangeVecEnv(1)
    env.reset(seed=[0])
    env.arrays["ahead"][0, env.arrays["road"][0], 0] = CAR + 0.1
    env.arrays["v"][0] = 30.0
    *_, terminated, _, infos = env.step(np.array([[2.0, 0.0]]))
    assert terminated[0]
    assert infos["cost"][0] > COLLISION_COST


def test_changing_environments_brings_the_other_environments_cars_ahead():
    env = LaneChangeVecEnv(1)
    obs, _ = env.reset(seed=[3])
    env.arrays["v"][0] = env.arrays["now"][0].mean()
    obs = env._observe()
    after, *_ = env.step(np.array([[0.0, 1.0]]))
    moved = 0.2 * obs[0, 4]
    assert after[0, 1] == pytest.approx((obs[0, 3] + CAR + moved) % RING - CAR)
    assert after[0, 7] == 0.0


def test_tuning_and_analysis_know_whole_numbers_and_options(tmp_path, monkeypatch):
    monkeypatch.setattr(style, "image", lambda *figure, **options: b"<svg></svg>")  # unseen
    result = zoac.tune(task="lane_change", tuner="random", budget=600, num_envs=2, quiet=True,
                       eval_every=600, episodes=1, final_episodes=1, folder=tmp_path)  # fmt: skip
    assert isinstance(result.parameters["patience"], int)
    assert result.parameters["better"] in ("speed", "gap")
    assert zoac.load_result(tmp_path).controller()(GOOD[0]).shape == (2,)
    assert set(result.record["violations_by_constraint"]) == {"distance"}
    out = tmp_path / "out"
    assert report.main([str(tmp_path), "--out", str(out)]) == 0
    (page,) = out.glob("*.html")
    assert "speed, gap" in page.read_text()
    quick = ["--tuner", "random", "--points", "2", "--episodes", "1", "--format", "svg"]
    assert landscape.main([str(tmp_path), "--out", str(out), *quick]) == 0
