"""The command line: `softarm ...`, or `python -m softarm ...`."""

import signal
import sys

from . import _softarm


def main() -> int:
    """Runs the command line with the arguments of this process, and returns its exit code."""
    # Signals are for the command, which writes its best result before it ends.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _softarm.main(["softarm", *sys.argv[1:]])


if __name__ == "__main__":
    sys.exit(main())
