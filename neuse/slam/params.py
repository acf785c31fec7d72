"""Everything that can be set in the SLAM stage."""

from dataclasses import dataclass, field

from neuse.params import CheckedParams, param
from neuse.slam.association import AssociationParams
from neuse.slam.checks import check_choice
from neuse.slam.edges import EdgeParams
from neuse.slam.instantiation import InstantiationParams
from neuse.slam.keyframes import KeyframeParams
from neuse.slam.object_frames import SigmaParams
from neuse.slam.odometry import OdometryParams
from neuse.slam.refinement import RefinementParams
from neuse.slam.smoother import SolverParams


@dataclass(frozen=True)
class SlamParams(CheckedParams):
    """Everything that can be set in the SLAM stage; nested names are dotted in ROS."""

    mode: str = param(
        "landmarks", "landmarks: objects are in the graph; edges: the paper's edges between poses"
    )
    use_ambiguous: bool = param(
        True, "let bottles and other ambiguous objects constrain poses (paper: All-object)"
    )
    stamp_tolerance_s: float = param(
        0.02, "external edges name a frame by its stamp within this, s", 0.0, 10.0
    )
    sigmas: SigmaParams = field(default_factory=SigmaParams)
    association: AssociationParams = field(default_factory=AssociationParams)
    instantiation: InstantiationParams = field(default_factory=InstantiationParams)
    keyframes: KeyframeParams = field(default_factory=KeyframeParams)
    edges: EdgeParams = field(default_factory=EdgeParams)
    refinement: RefinementParams = field(default_factory=RefinementParams)
    odometry: OdometryParams = field(default_factory=OdometryParams)
    solver: SolverParams = field(default_factory=SolverParams)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("mode", self.mode, ("landmarks", "edges"))
