import numpy as np

from zoac.tasks.pid_acc import IncrementalPid, PidAcc


def test_increments_add_up_to_the_positional_pid():
    """u = Kp e + Ki sum(e) + Kd (e_t - e_{t-1}), the discrete form of eq. (12), from rest."""
    rng = np.random.default_rng(0)
    k, kp, ki, kd = rng.uniform(0, 10, 4)
    states = np.concatenate([np.zeros((2, 3)), rng.normal(size=(50, 3))])
    params = {
        n: np.array([v]) for n, v in zip(("k", "Kp", "Ki", "Kd"), (k, kp, ki, kd), strict=True)
    }
    u, pid = 0.0, IncrementalPid()
    e = k * states[:, 0] + states[:, 1]
    for t in range(2, 52):
        obs = np.concatenate([states[t], states[t - 1], states[t - 2], [u]])[None]
        du, memory, _ = pid.act(params, obs, {})
        assert memory == {}
        u += du[0, 0]
        positional = kp * e[t] + ki * e[: t + 1].sum() + kd * (e[t] - e[t - 1])
        np.testing.assert_allclose(u, positional, rtol=1e-9)


def test_every_gain_changes_the_action():
    pid, obs = IncrementalPid(), np.random.default_rng(1).normal(size=(1, 10))
    base = {name: np.array([1.0]) for name in PidAcc.space.names}
    action = pid.act(base, obs, {})[0]
    for name in PidAcc.space.names:
        assert pid.act({**base, name: np.array([1.1])}, obs, {})[0] != action


def test_acting_leaves_parameters_and_observations_alone():
    params = {name: np.ones(2) for name in PidAcc.space.names}
    obs = np.random.default_rng(2).normal(size=(2, 10))
    before = obs.copy()
    IncrementalPid().act(params, obs, {})
    assert np.array_equal(obs, before)
    assert all((v == 1.0).all() for v in params.values())
