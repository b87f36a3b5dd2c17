"""A session with the simulated arm, and with a simulated person where teacher:=DDCCPP is given."""

from launch import LaunchDescription

from unifeed_ros.nodes.launching import describe_session


def generate_launch_description() -> LaunchDescription:
    """Describe the nodes from the table that `unifeed up --sim` reads too."""
    return describe_session(simulated=True)
