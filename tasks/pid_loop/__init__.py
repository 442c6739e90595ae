"""A PID in a loop with a linear plant, or with several: what `zoac.tune_pid` tunes."""

from zoac.tasks.pid_loop.design import designed
from zoac.tasks.pid_loop.plants import Design
from zoac.tasks.pid_loop.task import PidLoop

__all__ = ["Design", "PidLoop", "designed"]
