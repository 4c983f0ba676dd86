"""A process that ends when the one it works for does, also where that one is killed without a word."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time

INTERVAL_S = 0.5
"""Time between two looks at the other process."""
PR_SET_PDEATHSIG = 1


def end_with(master: int) -> None:
    """Have this process killed as soon as another one is gone.

    Parameters
    ----------
    master : int
        Id of the other process: the parent, or one further up.
    """
    me = os.getpid()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # at once, where it is the parent

    def watch() -> None:
        while True:
            try:
                os.kill(master, 0)
            except ProcessLookupError:
                os.kill(me, signal.SIGKILL)
            except PermissionError:
                pass
            time.sleep(INTERVAL_S)

    threading.Thread(target=watch, daemon=True).start()
