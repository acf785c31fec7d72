"""Processes that train one network together: those that torchrun started, or this one alone."""

import os
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import distributed

PATIENCE = timedelta(hours=3)  # while the first process draws the views


@dataclass(frozen=True)
class Group:
    """This process among those that train together."""

    rank: int
    size: int
    device: torch.device

    @property
    def is_first(self) -> bool:
        """Whether this process is the one that writes."""
        return self.rank == 0

    def wait(self) -> None:
        """Until all have come here."""
        if self.size > 1:
            distributed.barrier()

    def any(self, flag: bool) -> bool:
        """Whether `flag` is true in any of the processes."""
        if self.size == 1:
            return flag
        flags = torch.tensor([float(flag)], device=self.device)
        distributed.all_reduce(flags, distributed.ReduceOp.MAX)
        return bool(flags.item())


ALONE = Group(0, 1, torch.device("cpu"))


def join_group() -> Group:
    """The group by RANK, WORLD_SIZE and LOCAL_RANK of torchrun, each on a GPU if there are any."""
    has_gpu = torch.cuda.is_available()
    local_rank = int(os.environ.get("LOCAL_RANK", 0))
    device = torch.device("cuda", local_rank) if has_gpu else torch.device("cpu")
    size = int(os.environ.get("WORLD_SIZE", 1))
    if size > 1:
        if has_gpu:
            torch.cuda.set_device(device)
        distributed.init_process_group("nccl" if has_gpu else "gloo", timeout=PATIENCE)
    return Group(int(os.environ.get("RANK", 0)), size, device)


def leave_group(group: Group) -> None:
    """To be called once by every process of the group, at the end."""
    if group.size > 1:
        distributed.destroy_process_group()
