"""The systems that the tables compare: values of parameters that differ from the defaults."""

from typing import Any

from neuse.params import build
from neuse.pipeline import PipelineParams

CODES_ALONE = {"slam.refinement.lags": 0}
PAPER = CODES_ALONE | {
    "slam.mode": "edges",
    "slam.odometry.use": "blind",
    "slam.odometry.adapt": False,
    "slam.edges.max_closure_sigma_rad": 0.1,  # here closures hold the graph; elsewhere they are only told
    "slam.edges.max_closure_sigma_m": 0.1,
    "slam.edges.closure_spacing": 3,
    "slam.edges.max_closures": 10,
}
MUGS = {"slam.use_ambiguous": False}
NEVER_S = 1e9
OPEN_GATES = {
    "slam.edges.max_residual_m": 10.0,
    "slam.edges.max_sigma_rad": 3.2,
    "slam.edges.max_sigma_m": 100.0,
    "slam.edges.max_closure_sigma_rad": 3.2,
    "slam.edges.max_closure_sigma_m": 100.0,
    "slam.edges.max_disagreement": 1e6,
}

VARIANTS: dict[str, dict[str, Any]] = {
    "full": {},
    "full-mugs": MUGS,
    "full-ungated": OPEN_GATES,  # the landmark graph uses no such edges, so only what is published differs
    "paper": PAPER,
    "paper-mugs": PAPER | MUGS,
    "paper-no-loops": PAPER | {"slam.edges.max_closures": 0},
    "paper-nearest": PAPER | {"slam.association.method": "nearest"},
    "paper-no-proximity": PAPER
    | {"slam.association.method": "nearest", "slam.association.delta_prox_m": 1.0},
    "full-odometry-when-blind": {"slam.odometry.use": "blind"},
    "full-no-refinement": CODES_ALONE,
    "full-no-smooth-motion": {"slam.solver.acceleration_mps2": 0.0},
    "full-no-feedback": {"feedback_delay_s": NEVER_S},
}


def params_of(variant: str) -> PipelineParams:
    """Parameters of a variant.

    Raises:
        KeyError: no such variant.
    """
    return build(PipelineParams(), VARIANTS[variant])
