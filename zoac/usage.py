"""What `python -m zoac.run --help` prints, read from the configuration itself.

Hydra's own help composes every choice of every group first, which takes seconds.
"""

from __future__ import annotations

from pathlib import Path

import zoac.conf

_TEXT = """\
Tune a controller from its closed-loop performance.

usage: python -m zoac.run [group=choice ...] [key=value ...] [-m]

  python -m zoac.run task=pid_acc tuner=zoac seed=0
  python -m zoac.run task=mpc_tracking tuner=zoac -m seed=0,1,2,3,4     a sweep
  python -m zoac.run task=mpc_tracking tuner=bo --cfg job               show every option

== Groups ==
{groups}

== Keys ==
{keys}

Options of a choice are keys too: tuner.sigma=0.1, task.max_episode_steps=500, executor.workers=2.
--hydra-help shows Hydra's own flags.
"""


def usage() -> str:
    """Return the help text."""
    folder = Path(next(iter(zoac.conf.__path__)))
    groups = [
        f"{group.name}: {', '.join(sorted(p.stem for p in group.glob('*.yaml')))}"
        for group in sorted(folder.iterdir())
        if any(group.glob("*.yaml"))
    ]
    _, _, rest = (folder / "run.yaml").read_text().partition("\nseed:")
    keys, _, _ = f"seed:{rest}".partition("\nhydra:")
    return _TEXT.format(groups="\n".join(groups), keys=keys.strip())
