"""The whole graph: encoder, slam, mapper; on request a bag player, a recorder of the map topics, and RViz."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

NODES = ("encoder_node", "slam_node", "mapper_node")
ARGUMENTS = {
    "bag": ("", "bag to play; empty: live topics"),
    "rate": ("1.0", "pace of the bag, times the recorded one"),
    "record": ("", ".mcap file that keeps what the nodes publish; empty: none"),
    "rviz": ("false", "start RViz"),
    "use_sim_time": ("false", "take the time from /clock"),
    "params_file": ("", "YAML file of parameters for all nodes, over the defaults"),
    "depth_image": ("depth/image", "topic of the depth image"),
    "depth_camera_info": ("depth/camera_info", "topic of its camera info"),
    "mask": ("segmentation/mask", "topic of the instance mask"),
    "instances": ("segmentation/instances", "topic of the mask's instances"),
    "odom": ("odom", "topic of the odometry"),
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` starts."""
    arguments = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in ARGUMENTS.items()
    ]
    stages = OpaqueFunction(function=lambda context: [_stage(name, context) for name in NODES])
    return LaunchDescription([*arguments, stages, _recorder(), _player(), _rviz()])


def _stage(name: str, context: LaunchContext) -> Node:
    package = f"neuse_{name}"
    defaults = str(Path(get_package_share_directory(package), "config", f"{name}.yaml"))
    params_file = LaunchConfiguration("params_file").perform(context)
    use_sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    return Node(
        package=package,
        executable=name,
        parameters=[defaults, *filter(None, [params_file]), {"use_sim_time": use_sim_time}],
        remappings=[
            ("depth/image", LaunchConfiguration("depth_image")),
            ("depth/camera_info", LaunchConfiguration("depth_camera_info")),
            ("segmentation/mask", LaunchConfiguration("mask")),
            ("segmentation/instances", LaunchConfiguration("instances")),
            ("odom", LaunchConfiguration("odom")),
        ],
        output="screen",
    )


def _recorder() -> Node:
    path = LaunchConfiguration("record")
    return Node(
        package="neuse_bags",
        executable="record",
        arguments=["--out", path],
        condition=_is_given(path),
        output="screen",
    )


def _player() -> Node:
    path = LaunchConfiguration("bag")
    return Node(
        package="neuse_bags",
        executable="play",
        arguments=[path, "--clock", "--rate", LaunchConfiguration("rate"), "--wait-for", "120"],
        condition=_is_given(path),
        output="screen",
    )


def _rviz() -> Node:
    config = str(Path(get_package_share_directory("neuse_mapper_node"), "config", "neuse.rviz"))
    return Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", config],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )


def _is_given(path: LaunchConfiguration) -> IfCondition:
    return IfCondition(PythonExpression(["'", path, "' != ''"]))
