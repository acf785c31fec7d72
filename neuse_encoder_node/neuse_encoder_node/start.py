"""The start of a process. Imports take seconds, and Ctrl-C must end those as quietly as the rest."""

import ctypes
import os
import signal
from importlib import import_module

INTERRUPTED = 130
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # M_..., options of glibc's mallopt
KEPT_BYTES, LARGEST_BYTES = 256 * 2**20, 32 * 2**20


def start(module: str) -> int | None:
    """Import a module and run its `main`; Ctrl-C before that ends the process without a traceback."""
    keep_freed_memory()
    keep_blas_to_one_thread()
    before = signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED))
    main = import_module(module).main
    signal.signal(signal.SIGINT, before)
    return main()


def keep_freed_memory() -> None:
    """Let the process keep what it frees for what it allocates next.

    Images and activations come and go with every frame; glibc would give their pages back each time, and to
    get new ones takes longer than the arithmetic on them. Other C libraries do as they like.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(MMAP_THRESHOLD, LARGEST_BYTES)
        mallopt(TRIM_THRESHOLD, KEPT_BYTES)


def keep_blas_to_one_thread() -> None:
    """Let NumPy's products stay in their own thread, unless the environment says otherwise.

    They are small: beside the other nodes threads only wait for a free core, ten times as long as the product
    takes. The networks' threads are a parameter of encoder_node. Has to come before NumPy.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
