"""A study at the command line: experiments that a script, a rig or a person runs.

python -m zoac.study create rig --space space.yaml --experiments 60
python -m zoac.study ask rig
python -m zoac.study tell rig 1 --cost 3.4

`python -m zoac.study --help` lists all commands. Python has the same as `zoac.Study`.
"""

import sys

from zoac.run.pipes import reader_may_leave
from zoac.study.commands import command


@reader_may_leave()
def main() -> None:
    """Run the command line."""
    sys.exit(command(sys.argv[1:]))


if __name__ == "__main__":
    main()
