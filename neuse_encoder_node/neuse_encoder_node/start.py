"""The start of a process. Imports take seconds, and Ctrl-C must end those as quietly as the rest."""

import os
import signal
from importlib import import_module

INTERRUPTED = 130


def start(module: str) -> int | None:
    """Import a module and run its `main`; Ctrl-C before that ends the process without a traceback."""
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    main = import_module(module).main
    signal.signal(signal.SIGINT, before)
    return main()
