"""A PI controller for a plant with dead time, from requirements."""

import control

import zoac
from zoac import specs

result = zoac.tune_pid(
    control.tf([2.0], [0.1, 0.7, 1.0]),  # the plant: 2 / ((0.5 s + 1)(0.2 s + 1))
    dead_time=0.1,
    sample_time=0.02,
    input_limits=(-2.0, 2.0),
    noise=0.005,
    baseline={"Kp": 2.0, "Ki": 3.0},  # your present gains
    specs=[
        specs.overshoot("y", "r", max=0.05),
        specs.settling_time("y", "r", max=2.0),
        specs.max_sensitivity(max=1.6),
    ],
)
print(result)
result.plot("step.svg")
