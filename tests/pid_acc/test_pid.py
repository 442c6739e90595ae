import numpy as np

from zoac.tasks.pid_acc import IncrementalPid


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
        before = obs.copy()
        du, memory, _ = pid.act(params, obs, {})
        assert memory == {}
        assert np.array_equal(obs, before)
        u += du[0, 0]
        positional = kp * e[t] + ki * e[: t + 1].sum() + kd * (e[t] - e[t - 1])
        np.testing.assert_allclose(u, positional, rtol=1e-9)
    assert [v[0] for v in params.values()] == [k, kp, ki, kd]
