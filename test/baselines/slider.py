"""An arm that needs no kinematics, so that what a method learns can be worked out by hand."""

import numpy as np

from unifeed_ros.core.feedback.items import Correction
from unifeed_ros.core.types import Context, Trajectory

CONTEXT = Context(goal=np.array([0.6, 0.0, 0.2]))
FEATURES = ("height(0.0)", "distance_xy(goal)")


class Slider:
    """A tool that three prismatic joints move along x, y and z, always pointing down."""

    joint_names = ("x", "y", "z")

    def tool_states(self, q):
        return np.concatenate([q, np.tile([0.0, 0.0, -1.0], (len(q), 1))], axis=1)


def motion(points, duration=2.0):
    return Trajectory(joint_names=Slider.joint_names, times=np.linspace(0.0, duration, len(points)),
                      positions=np.asarray(points, dtype=float))


def correction(before, after):
    return Correction(id="c", robot="slider", context=CONTEXT, planned=motion(before), corrected=motion(after),
                      span=(0.5, 2.5))
