"""A session with a real arm, whose driver is already running and remapped to the topics of msg_docs/topics.md."""

from launch import LaunchDescription

from unifeed_ros.nodes.launching import describe_session


def generate_launch_description() -> LaunchDescription:
    """Describe the nodes from the table that `unifeed up` reads too."""
    return describe_session(simulated=False)
