"""ZOAC's options by short names, and its critic as PyTorch modules, for tests."""

from dataclasses import fields
from typing import Any

import torch

from zoac.algorithm.options import CriticOptions, Exploration, StepSize

GROUPS = {"exploration": Exploration, "step_size": StepSize, "critic": CriticOptions}
OF_GROUP = {f.name: group for group, kind in GROUPS.items() for f in fields(kind)}


def grouped(**options: Any) -> dict[str, Any]:
    """Return options with those of a group gathered in it, by the field's name alone.

    `step_size` is the group's first one, not the critic's.
    """
    gathered: dict[str, dict[str, Any]] = {}
    for name, value in options.items():
        group, field = ("step_size", "first") if name == "step_size" else (OF_GROUP.get(name), name)
        gathered.setdefault(group or "", {})[field] = value
    plain = gathered.pop("", {})
    return plain | {group: GROUPS[group](**given) for group, given in gathered.items()}


def torch_twin(critic):
    """The same network as PyTorch modules, with the same weights."""
    layers = []
    for matrix, bias in critic._layers:
        linear = torch.nn.Linear(*matrix.shape)
        linear.weight.data.copy_(matrix.t())
        linear.bias.data.copy_(bias)
        layers += [linear, torch.nn.Tanh()]
    return torch.nn.Sequential(*layers[:-1])
