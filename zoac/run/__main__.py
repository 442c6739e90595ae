"""`python -m zoac.run`; see `zoac.run.command`."""

import signal

from zoac.run.pipes import leave

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # What follows takes a while to import: Ctrl-C comes before `main` can catch it.
    signal.signal(signal.SIGINT, leave)

from zoac.run.command import main

if __name__ == "__main__":
    main()
