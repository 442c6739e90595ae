"""Linear policies of MuJoCo's robots: ZOAC beside ARS.

    python -m benchmarks.linear_policies --env Hopper-v5 --method zoac --seeds 0 1
    python -m benchmarks.linear_policies --table

One row per run goes to results/linear_policies.csv: the mean return of the last policy over 20
episodes, without noise and with noise of standard deviation 0.1 on the normalised observations.
Policies learn without noise; on Hopper both learn without the reward for being upright. ARS is that
of sb3-contrib (pip install sb3-contrib) with its authors' step sizes and perturbations, and 8
directions. Settings were chosen on seeds 100 and 101.
"""

from __future__ import annotations

import argparse
import csv
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd

import zoac
from zoac.controllers.neural import linear, observation_moments

RESULTS = Path(__file__).parents[1] / "results" / "linear_policies.csv"
COLUMNS = ["env", "method", "seed", "steps", "noise", "return_mean", "return_std", "seconds"]
NOISE, EPISODES, RANDOM_EPISODES = (0.0, 0.1), 20, 20

_CRITIC = {"epochs": 5, "normalise_observations": True, "target_scale": 0.02}
ZOAC: dict[str, dict[str, Any]] = {
    "HalfCheetah-v5": {"bound": 1.0, "step_size": {"first": 0.1}, "critic": _CRITIC},
    "Hopper-v5": {
        "bound": 2.0, "exploration": {"segments": 16}, "lam": 0.97, "critic": _CRITIC,
        "of_env": {"healthy_reward": 0.0},
    },
}  # fmt: skip
ARS: dict[str, dict[str, Any]] = {
    "HalfCheetah-v5": {"learning_rate": 0.02, "delta_std": 0.03, "n_delta": 8, "n_top": 4},
    "Hopper-v5": {
        "learning_rate": 0.01, "delta_std": 0.025, "n_delta": 8, "n_top": 4,
        "alive_bonus_offset": -1.0,
    },
}  # fmt: skip

Policy = Callable[[np.ndarray], np.ndarray]
"""Returns the action for an observation."""


def by_zoac(env: str, seed: int, steps: int, options: dict[str, Any]) -> tuple[Policy, np.ndarray]:
    """Return the last policy of ZOAC, and the standard deviation of observations under it."""
    chosen = ZOAC[env] | options
    make = partial(gymnasium.make, env, **chosen.pop("of_env", {}))
    act, space = linear(env, bound=chosen.pop("bound"), random_episodes=RANDOM_EPISODES)
    result = zoac.tune(
        env=make, controller=act, space=space, baseline=dict.fromkeys(space, 0.0), tuner="zoac",
        seed=seed, budget=steps, eval_every=steps // 4, episodes=2, final_episodes=2, quiet=True,
        executor="serial", tuner_options={"start": "baseline"} | chosen,
    )  # fmt: skip
    _, std = observation_moments(env, RANDOM_EPISODES)
    print(env, seed, [-round(c) for c in result.history.query("kind == 'eval'").cost_mean])
    return lambda obs: act(result.parameters, obs), std


def by_ars(env: str, seed: int, steps: int, options: dict[str, Any]) -> tuple[Policy, np.ndarray]:
    """Return the last policy of ARS (V2), and the standard deviation of observations under it."""
    from sb3_contrib import ARS as Ars
    from stable_baselines3.common.env_util import make_vec_env
    from stable_baselines3.common.vec_env import VecNormalize

    envs = VecNormalize(make_vec_env(env, seed=seed), norm_reward=False)
    model = Ars("LinearPolicy", envs, seed=seed, **(ARS[env] | options))
    model.learn(steps)
    envs.training = False
    return (
        lambda obs: model.predict(envs.normalize_obs(obs), deterministic=True)[0],
        np.sqrt(envs.obs_rms.var),
    )


METHODS = {"zoac": by_zoac, "ars": by_ars}


def returns(env: str, policy: Policy, std: np.ndarray, noise: float) -> list[float]:
    """Return those of `EPISODES` episodes, the same for every policy, of 1,000 steps at most."""
    made, rng, all_returns = gymnasium.make(env), np.random.default_rng(0), []
    for seed in range(EPISODES):
        obs, _ = made.reset(seed=10_000 + seed)
        total, over = 0.0, False
        while not over:
            seen = obs + noise * std * rng.standard_normal(obs.shape)
            obs, reward, terminated, truncated, _ = made.step(policy(seen))
            total, over = total + float(reward), terminated or truncated
        all_returns.append(total)
    return all_returns


def run(env: str, method: str, seed: int, steps: int, options: dict[str, Any]) -> list[list[Any]]:
    """Return a row for each noise."""
    begun = time.process_time()
    policy, std = METHODS[method](env, seed, steps, options)
    seconds = round(time.process_time() - begun, 1)
    rows = []
    for noise in NOISE:
        found = returns(env, policy, std, noise)
        mean, deviation = round(float(np.mean(found)), 1), round(float(np.std(found, ddof=1)), 1)
        rows.append([env, method, seed, steps, noise, mean, deviation, seconds])
    return rows


def table(rows: pd.DataFrame) -> str:
    """Return mean, standard deviation, median and worst seed of each method."""
    lines = [
        "| environment | method | noise | seeds | return | median | worst seed | seconds |",
        "|---|---|---:|---:|---|---:|---:|---:|",
    ]
    for (env, method, noise), own in rows.groupby(["env", "method", "noise"]):
        found = own.return_mean
        lines.append(
            f"| {env} | {method} | {noise:g} | {len(own)} | {found.mean():,.0f} ± "
            f"{found.std():,.0f} | {found.median():,.0f} | {found.min():,.0f} | "
            f"{own.seconds.mean():.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run what is asked for, or print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", choices=sorted(ZOAC))
    parser.add_argument("--method", choices=sorted(METHODS))
    parser.add_argument("--seeds", type=int, nargs="*", default=[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--options", type=json.loads, default={}, help="of the method, as JSON")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    if not options.table:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        with options.out.open("a", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            if file.tell() == 0:
                writer.writerow(COLUMNS)
            for seed in options.seeds:
                writer.writerows(
                    run(options.env, options.method, seed, options.steps, options.options)
                )
                file.flush()
    print(table(pd.read_csv(options.out)))


if __name__ == "__main__":
    main()
