"""A plain function as controller: balance Gymnasium's cart-pole by four gains.

python examples/function_controller.py
"""

import argparse

import zoac


def act(params, obs):
    """Return a number; the nearest of the actions 0 (push left) and 1 (push right) is taken."""
    position, speed, angle, rate = obs
    push = (
        params["position"] * position
        + params["speed"] * speed
        + params["angle"] * angle
        + params["rate"] * rate
    )
    return 1.0 if push > 0 else 0.0


def main():
    """Tune and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=int, default=20_000, help="environment steps")
    options = parser.parse_args()
    result = zoac.tune(
        env="CartPole-v1",
        controller=act,
        space=dict.fromkeys(("position", "speed", "angle", "rate"), (-1.0, 1.0)),
        tuner="zoac_plus",
        budget=options.budget,
        quiet=True,
    )
    print(f"steps balanced, of 500: {-result.cost_mean:.0f}")
    print({name: round(value, 3) for name, value in result.parameters.items()})


if __name__ == "__main__":
    main()
