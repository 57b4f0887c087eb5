"""The start of ``pearl``: the rest takes a second to load, in which Ctrl-C ends it without a traceback."""

from __future__ import annotations

import os
import signal
from typing import Any


def leave(*_: Any) -> None:
    """End the process at once: nothing is open yet."""
    os.write(2, b"pearl: interrupted\n")
    os._exit(130)


def main() -> None:
    """Run the command line."""
    signal.signal(signal.SIGINT, leave)
    from pearl_marl.cli import main as run

    run()


if __name__ == "__main__":
    main()
