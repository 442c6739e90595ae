"""Search for a tuner's own options, such as ZOAC's sigma, N, H and step size, on Optuna.

python -m zoac.search task=pid_acc tuner=zoac budget=100000 search.trials=40

A trial is a few runs, one a seed; its value is their mean final cost. Give the same command in
several processes, on one machine or many that share the folder: they work on one study. A process
that is killed loses nothing: whoever comes next takes up its trial where its checkpoint stood.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

from omegaconf import OmegaConf

from zoac.config.compose import compose_config
from zoac.config.validate import check_arguments
from zoac.core.errors import ConfigError, ZoacError
from zoac.run.pipes import reader_may_leave
from zoac.search.search import Search


def split(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the overrides of the runs, and those of the search.

    Without `search=<choice>` the search is called like the tuner.

    Raises:
        ConfigError: If an argument is none, or belongs to the search itself.
    """
    runs, own, choice, tuner = [], [], None, "zoac"
    for argument in arguments:
        key, equals, value = argument.lstrip("+~").partition("=")
        if argument in ("-m", "--multirun"):
            raise ConfigError("a search is no sweep: leave out -m, and use search.seeds")
        if not equals and not argument.startswith("~"):
            raise ConfigError(f"cannot read the override {argument!r}; write key=value")
        if key in ("seed", "variant", "runs_dir", "resume", "evaluation.seed"):
            raise ConfigError(f"{key} is set for each run of a search; see search.seeds")
        if key == "search":
            choice = value
        elif key.startswith("search."):
            own.append(argument)
        else:
            runs.append(argument)
            tuner = value if key == "tuner" else tuner
    return runs, [f"+search={choice or tuner}", *own]


@reader_may_leave()
def main() -> None:
    """Run the command line; exits with 1 and one message on a user's error."""
    if sys.argv[1:] in (["--help"], ["-h"]):
        print(__doc__)
        return
    try:
        runs, own = split(sys.argv[1:])
        node = compose_config([*runs, *own]).search
        options: Any = OmegaConf.to_container(node, resolve=True)
        check_arguments(Search, options, "search", provided=("overrides",))
        search = Search(overrides=runs, **options)
        search.run()
        search.conclude()
    except ZoacError as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        print("interrupted; the same command goes on", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
