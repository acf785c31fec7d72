"""Adds neuse/edges to a gtsam graph and writes it as graph.g2o. Needs rclpy, gtsam, numpy and neuse_msgs."""

import gtsam
import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException

from neuse_msgs.msg import PoseGraphEdge, PoseGraphEdgeArray

ROTATION_FIRST = [3, 4, 5, 0, 1, 2]
graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()


def factor_of(edge: PoseGraphEdge) -> gtsam.BetweenFactorPose3:
    """ROS: covariance translation first, on the axes of `from`; gtsam: rotation first, on those of `to`."""
    q, p = edge.pose.pose.orientation, edge.pose.pose.position
    T_from_to = gtsam.Pose3(gtsam.Rot3.Quaternion(q.w, q.x, q.y, q.z), np.array([p.x, p.y, p.z]))
    R = np.kron(np.eye(2), T_from_to.rotation().matrix())
    covariance = R.T @ edge.pose.covariance.reshape(6, 6)[np.ix_(ROTATION_FIRST, ROTATION_FIRST)] @ R
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose3(edge.from_id, edge.to_id, T_from_to, noise)


def receive(message: PoseGraphEdgeArray) -> None:
    for edge, factor in zip(message.edges, map(factor_of, message.edges), strict=True):
        graph.add(factor)
        if not values.exists(edge.from_id):
            values.insert(edge.from_id, gtsam.Pose3())
        if not values.exists(edge.to_id):
            values.insert(edge.to_id, values.atPose3(edge.from_id) * factor.measured())
    print(f"{graph.size()} edges between {values.size()} keyframes", flush=True)


rclpy.init()
node = rclpy.create_node("edges_to_gtsam")
node.create_subscription(PoseGraphEdgeArray, "neuse/edges", receive, 100)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    gtsam.writeG2o(graph, values, "graph.g2o")
