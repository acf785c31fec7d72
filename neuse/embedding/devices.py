"""On what the networks run."""

import torch

from neuse.errors import InputError

AUTO = "auto"
MEANING = "what the networks run on: auto (a GPU where there is one), cpu, cuda, cuda:1, ..."


def device_named(name: str = AUTO) -> torch.device:
    """The device that torch knows by a name; "auto" is a GPU where there is one, else the processor.

    Raises:
        InputError: `device`, this machine has none of that name.
    """
    if name == AUTO:
        name = "cuda" if torch.cuda.is_available() else "cpu"
    try:
        return torch.empty(0, device=name).device
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise InputError("device", f"no device {name!r} here ({reason}); give auto, cpu or cuda") from error
