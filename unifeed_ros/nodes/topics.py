"""The table of topics: names, types, rates, quality of service, who writes and who reads."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

SENSOR, EVENT, LATCHED, STREAM = "sensor", "event", "latched", "stream"
"""Names of the qualities of service: fast states, things that must all arrive, newest value kept, what comes again."""

PUBLISHER_DEPTH = {SENSOR: 3000, EVENT: 100, LATCHED: 10, STREAM: 500}
"""Messages kept for a reliable reader that is late; seconds of each, or a recorder on a busy machine loses some."""
SUBSCRIBER_DEPTH = {SENSOR: 10, EVENT: 100, LATCHED: 1, STREAM: 50}
RECORDER_DEPTH = {SENSOR: 5000, EVENT: 1000, LATCHED: 100, STREAM: 1000}


@dataclass(frozen=True)
class Topic:
    """One topic of a session."""

    name: str
    """Name; relative unless it starts with a slash."""

    type: str
    """Type, as "package/msg/Type"."""

    qos: str
    """Name of its quality of service: "sensor", "event", "latched" or "stream"."""

    rate: float
    """Nominal rate [Hz]; 0 where it is published on change only."""

    writer: tuple[str, ...]
    """Nodes that publish it."""

    readers: tuple[str, ...]
    """Nodes that subscribe to it, besides the recorder, the console and the terminal, which read every topic."""

    def __post_init__(self) -> None:
        """Reject a quality of service that is not in the table."""
        if self.qos not in PUBLISHER_DEPTH:
            known = ", ".join(PUBLISHER_DEPTH)
            raise ValueError(f"quality of service of {self.name}: expected one of {known}, got {self.qos}")

    @property
    def latched(self) -> bool:
        """True if a late subscriber gets what was published before it came."""
        return self.qos in (EVENT, LATCHED)


JOINT_STATE, TRAJECTORY = "sensor_msgs/msg/JointState", "trajectory_msgs/msg/JointTrajectory"

ALL_NODES = ("sim_arm", "sim_teacher", "capture", "reward_learner", "trajectory_optimizer", "shared_control", "session",
             "recorder", "console", "terminal")

TOPICS: tuple[Topic, ...] = (
    Topic("joint_states", JOINT_STATE, SENSOR, 1000.0, ("sim_arm",), ("sim_teacher", "capture", "shared_control")),
    Topic("external_torques", JOINT_STATE, SENSOR, 1000.0, ("sim_arm",), ("capture", "shared_control")),
    Topic("hand_wrench", "geometry_msgs/msg/WrenchStamped", SENSOR, 500.0, ("sim_teacher", "console"), ("sim_arm",)),
    Topic("joint_command", JOINT_STATE, SENSOR, 500.0, ("shared_control",), ("sim_arm",)),
    Topic("joint_setpoint", JOINT_STATE, SENSOR, 500.0, ("shared_control",), ("sim_arm",)),
    Topic("joint_trajectory", TRAJECTORY, SENSOR, 500.0, ("shared_control",), ("sim_arm",)),
    Topic(
        "teaching_state",
        "unifeed_msgs/msg/TeachingState",
        STREAM,
        100.0,
        ("shared_control",),
        ("sim_teacher", "capture", "session"),
    ),
    Topic("trajectory", TRAJECTORY, LATCHED, 0.0, ("shared_control",), ("sim_teacher", "capture")),
    Topic("trajectory_preview", TRAJECTORY, LATCHED, 0.0, ("trajectory_optimizer",), ()),
    Topic("contact", "unifeed_msgs/msg/Contact", STREAM, 100.0, ("capture",), ()),
    Topic("tracked_run", "unifeed_msgs/msg/TrackedRun", EVENT, 0.0, ("capture",), ("reward_learner",)),
    Topic(
        "feedback",
        "unifeed_msgs/msg/Feedback",
        EVENT,
        0.0,
        ("capture", "reward_learner", "console", "terminal"),
        ("reward_learner", "session"),
    ),
    Topic(
        "reward_model",
        "unifeed_msgs/msg/RewardModel",
        LATCHED,
        0.0,
        ("reward_learner",),
        ("trajectory_optimizer", "session"),
    ),
    Topic("reward_status", "unifeed_msgs/msg/RewardStatus", LATCHED, 0.0, ("reward_learner",), ()),
    Topic("preference_query", "unifeed_msgs/msg/PreferenceQuery", LATCHED, 0.0, ("session",), ("sim_teacher",)),
    Topic(
        "lesson_state", "unifeed_msgs/msg/LessonState", STREAM, 10.0, ("session",), ("sim_teacher", "shared_control")
    ),
    Topic("interaction", "unifeed_msgs/msg/Interaction", EVENT, 0.0, ("session",), ()),
    Topic("control_holder", "std_msgs/msg/String", LATCHED, 0.0, ("session",), ()),
    Topic("/clock", "rosgraph_msgs/msg/Clock", STREAM, 100.0, ("sim_arm",), ()),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", STREAM, 1.0, ALL_NODES, ("session",)),
)

BY_NAME = {topic.name.lstrip("/"): topic for topic in TOPICS}


def find_topic(name: str) -> Topic:
    """Look a topic up.

    Args:
        name: Its name in the table; a leading slash does not matter.

    Returns:
        The topic.

    Raises:
        KeyError: No topic has this name.
    """
    return BY_NAME[name.lstrip("/")]


def publisher_qos(topic: Topic | str) -> QoSProfile:
    """Give the quality of service that the topic is published with; always reliable.

    Args:
        topic: Topic of the table, or its name.

    Returns:
        The profile.
    """
    topic = find_topic(topic) if isinstance(topic, str) else topic
    return _profile(PUBLISHER_DEPTH[topic.qos], latched=topic.latched)


def subscriber_qos(topic: Topic | str, depth: int | None = None) -> QoSProfile:
    """Give the quality of service that a node subscribes with.

    What comes again by itself is taken best-effort. A reliable subscriber silently receives nothing from best-effort
    publishers, as those of real robots are; and once it has missed a message it keeps the newer ones back until that
    one has been sent again, which takes up to three seconds: an old state is worth less than none.

    Args:
        topic: Topic of the table, or its name.
        depth: Messages kept until the node takes them; by default those of SUBSCRIBER_DEPTH. A node that must see every
            sample asks for more.

    Returns:
        The profile.
    """
    topic = find_topic(topic) if isinstance(topic, str) else topic
    return _profile(depth or SUBSCRIBER_DEPTH[topic.qos], latched=topic.latched,
                    reliable=topic.qos in (EVENT, LATCHED))


def recorder_qos(topic: Topic | str) -> QoSProfile:
    """Give the quality of service that the recorder subscribes with: reliable, and deep enough for a slow disk.

    Args:
        topic: Topic of the table, or its name.

    Returns:
        The profile.
    """
    topic = find_topic(topic) if isinstance(topic, str) else topic
    return _profile(RECORDER_DEPTH[topic.qos], latched=topic.latched)


def _profile(depth: int, *, latched: bool, reliable: bool = True) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST, depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE)
