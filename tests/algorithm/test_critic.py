import copy
from contextlib import contextmanager

import numpy as np
import pytest
import torch

from tests.algorithm.support import torch_twin
from zoac.algorithm.adam import START, descend
from zoac.algorithm.critic import Critic, RunningStatistics, minibatches
from zoac.algorithm.options import CriticOptions


def make_critic(seed=0, epochs=1, minibatch=64, **options):
    rng = np.random.default_rng(seed)
    chosen = CriticOptions((16, 12), 1e-2, epochs, minibatch=minibatch, **options)
    return Critic(5, chosen, rng)


def test_values_are_those_of_the_network():
    critic = make_critic()
    observations = np.random.default_rng(1).normal(size=(9, 5))
    expected = torch_twin(critic)(torch.from_numpy(observations).float())[:, 0]
    np.testing.assert_allclose(critic.values(observations), expected.detach(), rtol=1e-5)


@pytest.mark.parametrize(("scale", "accuracy"), [(1.0, 1e-5), (1000.0, 1e-3)])
@pytest.mark.parametrize(("remainder", "sizes"), [("separate", [32, 32, 9]), ("joined", [32, 41])])
def test_fit_is_autograd_and_adam_on_equation_8(scale, accuracy, remainder, sizes):
    """Over shuffled minibatches, the last of an epoch smaller or larger than the others; saturated
    by observations of thousands, the first layer's tanh' is little but rounding."""
    epochs = 2
    critic = make_critic(epochs=epochs, minibatch=32, minibatch_remainder=remainder)
    twin, order = torch_twin(critic), copy.deepcopy(critic._rng)
    rng = np.random.default_rng(2)
    observations, targets = scale * rng.normal(size=(73, 5)), rng.normal(size=73)
    inputs, wanted = torch.from_numpy(observations).float(), torch.from_numpy(targets).float()
    adam = torch.optim.Adam(twin.parameters(), lr=1e-2)
    losses = []
    for _ in range(epochs):
        losses = []
        for chosen in torch.from_numpy(order.permutation(73)).split(sizes):
            adam.zero_grad()
            each = 0.5 * (twin(inputs[chosen])[:, 0] - wanted[chosen]) ** 2
            each.mean().backward()
            adam.step()
            losses.append(each.detach())
    assert critic.fit(observations, targets) == pytest.approx(
        torch.cat(losses).mean().item(), rel=accuracy
    )
    for (matrix, bias), linear in zip(critic._layers, twin[::2], strict=True):
        np.testing.assert_allclose(matrix.t(), linear.weight.detach(), atol=accuracy)
        np.testing.assert_allclose(bias, linear.bias.detach(), atol=accuracy)


@pytest.mark.parametrize(
    ("states", "join", "sizes"),
    [
        (1000, "separate", [128] * 7 + [104]),
        (1000, "joined", [128] * 6 + [232]),
        (400, "joined", [128, 128, 144]),
        (256, "joined", [128, 128]),
        (100, "joined", [100]),  # a last iteration cut short by episodes' ends
    ],
)
def test_sizes_of_minibatches(states, join, sizes):
    assert minibatches(states, CriticOptions(minibatch_remainder=join)) == sizes


def test_orthogonal_start_with_the_stated_gains():
    critic = make_critic()
    first, second, last = (matrix.numpy().T for matrix, _ in critic._layers)
    np.testing.assert_allclose(first.T @ first, (5 / 3) ** 2 * np.eye(5), atol=1e-5)
    np.testing.assert_allclose(second @ second.T, (5 / 3) ** 2 * np.eye(12), atol=1e-5)
    np.testing.assert_allclose(last @ last.T, [[1.0]], atol=1e-5)
    assert all(not bias.any() for _, bias in critic._layers)


@pytest.mark.parametrize("scale", [0.01, 10.0])
def test_target_scale_leaves_the_units_of_values_and_loss(scale):
    rng = np.random.default_rng(4)
    observations = rng.normal(size=(256, 5))
    targets = np.full(256, 3.0 / scale)
    critic = make_critic(epochs=80, target_scale=scale)
    loss = critic.fit(observations, targets)
    assert loss < 0.05 * (3.0 / scale) ** 2
    np.testing.assert_allclose(critic.values(observations).mean(), 3.0 / scale, rtol=0.1)


def test_restored_critic_continues_bit_for_bit():
    rng = np.random.default_rng(5)
    observations, targets = rng.normal(size=(100, 5)), rng.normal(size=100)
    critic = make_critic(epochs=2, normalise_observations=True)
    critic.fit(observations, targets)
    twin = make_critic(seed=9, epochs=2, normalise_observations=True)
    twin.restore(critic.state())
    assert critic.fit(observations, targets) == twin.fit(observations, targets)
    assert np.array_equal(critic.values(observations), twin.values(observations))


def test_a_state_does_not_change_with_the_critic_that_gave_or_took_it():
    rng = np.random.default_rng(6)
    observations, targets = rng.normal(size=(40, 5)), rng.normal(size=40)
    critic = make_critic(normalise_observations=True)
    critic.fit(observations, targets)
    saved = critic.state()
    before = copy.deepcopy(saved)
    critic.fit(observations, targets)
    np.testing.assert_equal(saved, before)
    critic.restore(saved)
    critic.fit(observations, targets)
    np.testing.assert_equal(saved, before)


def test_products_are_computed_on_one_thread(monkeypatch):
    threads, product = [], torch.addmm
    monkeypatch.setattr(
        torch, "addmm", lambda *a, **k: threads.append(torch.get_num_threads()) or product(*a, **k)
    )
    with settings_of_a_caller():
        critic = make_critic()
        critic.fit(np.ones((3, 5)), np.ones(3))
        critic.values(np.ones((3, 5)))
    assert threads
    assert set(threads) == {1}


@contextmanager
def settings_of_a_caller():
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    torch.set_default_dtype(torch.float64)
    try:
        with torch.device("meta"), torch.inference_mode():
            yield
    finally:
        torch.set_num_threads(threads)
        torch.set_default_dtype(torch.float32)


def test_bits_do_not_depend_on_the_callers_settings_of_torch_and_leave_them():
    rng = np.random.default_rng(12)
    observations, targets = rng.normal(size=(99, 5)), rng.normal(size=99)

    def outcome():
        critic = make_critic(normalise_observations=True)
        critic.restore(critic.state())
        loss = critic.fit(observations, targets)
        return loss, critic.values(observations)

    expected = outcome()
    with settings_of_a_caller():
        found = outcome()
        assert torch.get_num_threads() == 2
        assert torch.get_default_dtype() == torch.float64
        assert torch.is_inference_mode_enabled()
    assert found[0] == expected[0]
    np.testing.assert_array_equal(found[1], expected[1])
    with torch.enable_grad():
        critic = make_critic()
        critic.fit(observations, targets)
        assert torch.is_grad_enabled()


def test_running_statistics_are_those_of_all_observations_together():
    rng = np.random.default_rng(7)
    parts = [rng.normal(3.0, 2.0, size=(n, 2)) for n in (5, 1, 40)]
    statistics = RunningStatistics(2)
    for part in parts:
        statistics.update(part)
    everything = np.concatenate(parts)
    expected = (everything - everything.mean(axis=0)) / everything.std(axis=0)
    np.testing.assert_allclose(statistics.normalised(everything), expected, rtol=1e-6)


def test_a_mean_without_gradient_ends_at_zero_not_among_subnormal_numbers():
    rng = np.random.default_rng(9)
    critic = make_critic(epochs=1, minibatch=50)
    observations, targets = rng.normal(size=(50, 5)), rng.normal(size=50)
    critic.fit(observations, targets)
    observations[:, 0] = 0.0  # from now on the weights of this input have no gradient
    for _ in range(20):
        critic.fit(observations, targets, epochs=50)
    mean = critic.state()["adam"]["exp_avg"]
    assert not np.any((mean != 0) & (np.abs(mean) < np.finfo(np.float32).smallest_normal))
    assert np.array_equal(mean == 0, np.arange(len(mean)) < 16)


def test_adam_is_pytorchs():
    rng = np.random.default_rng(8)
    theta = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    reference = torch.optim.Adam([theta], lr=0.03)
    ours, moments = np.zeros(3), START
    for gradient in rng.normal(size=(20, 3)):
        theta.grad = torch.from_numpy(gradient)
        reference.step()
        ours, moments = descend(ours, moments, gradient, 0.03)
    np.testing.assert_allclose(ours, theta.detach().numpy(), rtol=1e-6)
