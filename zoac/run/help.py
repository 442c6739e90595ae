"""What `python -m zoac.run --help` prints, read from the configuration itself.

Hydra's own help composes every choice of every group first, which takes seconds.
"""

from pathlib import Path

import zoac.conf
from zoac.config.files import names_in, own_conf

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

Options of a choice are keys too: tuner.exploration.sigma=0.1, task.max_episode_steps=500,
executor.workers=2.
--hydra-help shows Hydra's own flags.
"""


def usage() -> str:
    """Return the help text."""
    folder = Path(next(iter(zoac.conf.__path__)))
    lines = _groups(folder)
    if (own := own_conf()) is not None and (of_their_own := _groups(own)):
        lines += ["", f"== Groups, from {own} ==", *of_their_own]
    _, _, rest = (folder / "run.yaml").read_text(encoding="utf-8").partition("\nseed:")
    keys, _, _ = f"seed:{rest}".partition("\nhydra:")
    return _TEXT.format(groups="\n".join(lines), keys=keys.strip())


def _groups(folder: Path) -> list[str]:
    # The group `search` is of `zoac.search`.
    groups = sorted(path for path in folder.iterdir() if path.is_dir() and path.name != "search")
    return [f"{group.name}: {', '.join(names)}" for group in groups if (names := names_in(group))]
