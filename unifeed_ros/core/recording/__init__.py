"""Bags in rosbag2's MCAP layout: written so that a crash loses at most a second, read, checked and recovered."""

from unifeed_ros.core.recording.check import Finding, check_bag
from unifeed_ros.core.recording.metadata import Qos, RecordedTopic
from unifeed_ros.core.recording.opening import OpenedBag, open_bag
from unifeed_ros.core.recording.reader import (
    BagInfo,
    BagMessage,
    TopicInfo,
    bag_info,
    bag_settings,
    bag_types,
    read_bag,
)
from unifeed_ros.core.recording.recover import FileRecovery, recover_bag
from unifeed_ros.core.recording.schema import MessageType, message_type
from unifeed_ros.core.recording.writer import BagWriter

__all__ = [
    "BagInfo",
    "BagMessage",
    "BagWriter",
    "FileRecovery",
    "Finding",
    "MessageType",
    "OpenedBag",
    "Qos",
    "RecordedTopic",
    "TopicInfo",
    "bag_info",
    "bag_settings",
    "bag_types",
    "check_bag",
    "message_type",
    "open_bag",
    "read_bag",
    "recover_bag",
]
