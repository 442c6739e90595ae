"""Built-in tasks, each one folder here and one YAML file in `conf/task`."""

import gymnasium


def register() -> None:
    """Make Gymnasium know `zoac/PidAcc-v0` and `zoac/MpcTracking-v0`; importing `zoac` does it."""
    for name, package, vec_env in (
        ("PidAcc", "pid_acc", "PidAccVecEnv"),
        ("MpcTracking", "mpc_tracking", "MpcTrackingVecEnv"),
    ):
        gymnasium.register(
            id=f"zoac/{name}-v0",
            entry_point=f"zoac.tasks.{package}.plant:make_single",
            vector_entry_point=f"zoac.tasks.{package}.plant:{vec_env}",
        )
