"""The optimum is known, so tuning can be held to it."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import zoac
from zoac.analysis.data.replay import costs
from zoac.tasks.lqr import Lqr, optimal_gain
from zoac.tasks.lqr.plant import A, B, Q, R


def test_the_cost_of_the_optimal_gains_is_the_riccati_equations():
    """Without noise the endless cost from x is x' P x; after 200 steps nothing is left of it."""
    task = Lqr(noise=0.0)
    p = solve_discrete_are(A, B, Q, R)
    env = task.make_env(1)
    x, _ = env.reset(options={"demonstration": True})
    start, total = x[0], 0.0
    for _ in range(200):
        x, _, _, _, infos = env.step(-(x @ optimal_gain())[:, None])
        total += infos["cost"][0]
    assert total == pytest.approx(start @ p @ start, rel=1e-6)


def test_a_step_is_the_matrices():
    env = Lqr(noise=0.0).make_env(2)
    x, _ = env.reset(seed=[1, 2])
    u = np.array([[0.3], [-0.7]])
    following, *_, infos = env.step(u)
    np.testing.assert_allclose(following, x @ A.T + u @ B.T)
    expected = [xi @ Q @ xi + ui @ R @ ui for xi, ui in zip(x, u, strict=True)]
    np.testing.assert_allclose(infos["cost"], expected)


def test_the_true_weights_give_the_optimal_gains():
    weights, gains = Lqr(tuned="weights"), Lqr(tuned="gains")
    obs = np.array([[1.0, -0.5], [0.2, 3.0]])
    actions = [
        t.make_controller().act(
            {name: np.full(2, value) for name, value in t.baseline.items()}, obs, {}
        )[0]
        for t in (weights, gains)
    ]
    np.testing.assert_allclose(actions[0], actions[1])


def test_tuning_reaches_the_known_optimum():
    """In cost, to 3%: about their best the gains hardly matter."""
    task = Lqr(max_episode_steps=60)
    result = zoac.tune(
        task=task, tuner="zoac_plus", budget=5_000, quiet=True, seed=0, episodes=1,
        eval_every=5_000, final_episodes=1,
    )  # fmt: skip
    points = np.stack(
        [task.space.normalise(result.parameters), task.space.normalise(task.baseline)]
    )
    tuned, best = costs(task, points, 50, 0).mean(axis=1)
    assert tuned < 1.03 * best


def test_other_gains_cost_more():
    task = Lqr()
    best = task.space.normalise(task.baseline)
    others = best + 0.1 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    mean = costs(task, np.concatenate([best[None], others]), 20, 0).mean(axis=1)
    assert mean.argmin() == 0
