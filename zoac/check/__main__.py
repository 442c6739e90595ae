"""Is a task fit to be tuned? `python -m zoac.check task=my_task [task.option=value ...]`

One verdict a line; exit code 1 if any is bad. It works on a user's task from their own folder.
"""

import sys
from collections.abc import Sequence

from zoac.check import check
from zoac.core.errors import ZoacError
from zoac.run.pipes import reader_may_leave


@reader_may_leave()
def main(arguments: Sequence[str] | None = None) -> int:
    """Check the task that the overrides name; return the exit code."""
    from zoac.config.compose import compose_config, resolved
    from zoac.config.factory import build_task

    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__.strip())
        return 0 if arguments else 1
    try:
        task = build_task(resolved(compose_config(arguments)))
    except ZoacError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    good = True
    for verdict in check(task):
        print(verdict, flush=True)
        good &= verdict.good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
