"""The node that records a session: every topic of the table into one bag."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from unifeed_msgs.srv import Mark
from unifeed_ros.core.errors import ConfigError, RecordingError
from unifeed_ros.core.recording import BagWriter, Qos, RecordedTopic, message_type
from unifeed_ros.core.recording.mcap_file import COMPRESSIONS
from unifeed_ros.core.recording.reader import SETTINGS_KEY
from unifeed_ros.nodes.node import ERROR, OK, WARN, UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.raw_input import RawInput
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.nodes.topics import BY_NAME, STREAM, TOPICS, Topic, publisher_qos, recorder_qos

POLL_S = 0.01
"""Time between two looks at the queues [s]."""

ADAPT_S = 0.5
"""Time between two looks at what the publishers offer [s]."""

BATCH = 1000
"""Most messages taken from one topic at a time, so that services are answered in between."""

LAST_BATCHES = 6
"""Batches taken before the bag is closed: more than the longest queue holds."""

MIB = 1024 * 1024


@dataclass(frozen=True, kw_only=True)
class RecorderConfig:
    """Settings of the recorder."""

    folder: str
    """Folder of the bag; it must not exist."""

    topics: Sequence[str] = ()
    """Topics to record: names in the table, or "name package/msg/Type" for others; the whole table if empty."""

    compression: str = "zstd"
    """Compression of the chunks: "none", "lz4" or "zstd"."""

    min_free_mib: float = 500.0
    """Free disk space at which recording stops [MiB]."""

    episodes: str = "interaction"
    """Topic whose messages each end an episode: the bag goes on in a new file; empty: one file for all."""

    linger: float = 0.3
    """Time that it goes on after it was told to end, for the last words of the other nodes [s]; at most 1."""

    def __post_init__(self) -> None:
        """Reject what would only fail later."""
        if not self.folder:
            raise ConfigError("folder of the bag", expected="a path", got="nothing", mend="set recorder.folder")
        if self.compression not in COMPRESSIONS:
            raise ConfigError("compression", expected=", ".join(COMPRESSIONS), got=self.compression)
        if not 0.0 <= self.linger <= 1.0:
            raise ConfigError("linger", expected="0 to 1 s", got=self.linger)
        if self.min_free_mib < 0.0:
            raise ConfigError("min_free_mib", expected=">= 0", got=self.min_free_mib)


class RecorderNode(UnifeedNode):
    """Takes every topic's messages as bytes and hands them to the bag writer."""

    def __init__(self) -> None:
        """Open the bag and subscribe."""
        super().__init__("recorder")
        self._config = settings(self, "recorder", RecorderConfig)
        topics = select_topics(self._config.topics)
        self._inputs_node = rclpy.create_node(
            f"{self.get_name()}_inputs", namespace=self.get_namespace(), use_global_arguments=False,
            enable_rosout=False, start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)])
        names = {topic.name: self.resolve_topic_name(topic.name) for topic in topics}
        self._inputs = [RawInput(self._inputs_node, names[t.name], t.type, recorder_qos(t)) for t in topics]
        self._writer = BagWriter(
            Path(self._config.folder), [_recorded(names[t.name], t) for t in topics],
            compression=self._config.compression, custom={SETTINGS_KEY: json.dumps(self._all_settings())})
        self._episodes = next((i for i in self._inputs if i.name == names.get(self._config.episodes)), None)
        self._stopped: RecordingError | None = None
        self._weakened: dict[str, str] = {}
        self.create_timer(POLL_S, self._poll, clock=self.steady)
        self.create_timer(ADAPT_S, self._adapt, clock=self.steady)
        self.create_service(Trigger, "split", self._on_split)
        self.create_service(Mark, "mark", self._on_mark)
        self.refresh_status()

    def close(self) -> None:
        """Take what still arrives, then close the bag.

        Raises:
            RecordingError: Recording had stopped before, or the disk refuses the end of the bag.
        """
        end = time.monotonic() + self._config.linger
        while self._stopped is None and time.monotonic() < end:
            self._poll()
            time.sleep(POLL_S)
        for _ in range(LAST_BATCHES):
            self._poll()
        self._inputs_node.destroy_node()
        if self._stopped is not None:
            raise self._stopped
        self._writer.close()

    def refresh_status(self) -> None:
        """Watch the disk and say what was recorded."""
        free = self._writer.free_bytes / MIB
        if self._stopped is None and free < self._config.min_free_mib:
            self._stop(RecordingError("recording stopped, the disk is almost full",
                                      expected=f"{self._config.min_free_mib:.0f} MiB free", got=f"{free:.0f} MiB",
                                      mend="make room and start the recorder anew"))
        counts = self._writer.counts
        lost = {i.name: i.lost for i in self._inputs if i.lost}
        values = {"bag": self._writer.folder, "messages": sum(counts.values()), "lost": sum(lost.values()),
                  "bytes": self._writer.bytes_written, "free_mib": f"{free:.0f}", **counts}
        if self._stopped is not None:
            self.say(ERROR, str(self._stopped), **values)
        elif lost:
            self.say(WARN, f"messages lost on {', '.join(lost)}", **values)
        elif self._weakened:
            self.say(WARN, "; ".join(self._weakened.values()), **values)
        else:
            self.say(OK, "recording", **values)

    def _all_settings(self) -> dict[str, Any]:
        """Gather every parameter of the session's files, by section, so that a bag can be learned from anywhere."""
        sections: dict[str, Any] = {}
        for name, parameter in self.get_parameters_by_prefix("").items():
            *path, last = name.split(".")
            place = sections
            for part in path:
                place = place.setdefault(part, {})
            value = parameter.value
            place[last] = list(value) if hasattr(value, "typecode") or isinstance(value, tuple) else value
        return sections

    def _poll(self) -> None:
        if self._stopped is not None:
            return
        try:
            for source in self._inputs:
                for message in source.take(BATCH):
                    self._writer.write(source.name, message.data, message.received, message.sent)
                    if source is self._episodes:
                        self._writer.split()
        except RecordingError as error:
            self._stop(error)

    def _adapt(self) -> None:
        for source in self._inputs:
            change = source.adapt()
            if change:
                self._weakened[source.name] = change

    def _stop(self, reason: RecordingError) -> None:
        self._stopped = reason
        try:
            self._writer.close()
        except RecordingError as error:
            self.get_logger().error(str(error))

    def _on_split(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._poll()
            finished = self._writer.split()
        except RecordingError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"closed {finished}"
        return response

    def _on_mark(self, request: Mark.Request, response: Mark.Response) -> Mark.Response:
        text = request.text or "mark"
        try:
            self._writer.mark(text)
        except RecordingError as error:
            response.success, response.message = False, str(error)
            return response
        response.success, response.message = True, f"marked: {text}"
        return response


def select_topics(wanted: Sequence[str]) -> tuple[Topic, ...]:
    """Choose the topics to record.

    Args:
        wanted: Names in the table, or "name package/msg/Type" for topics outside it; empty for the whole table.

    Returns:
        The topics, each once.

    Raises:
        ConfigError: A name is not in the table and comes without a type.
    """
    chosen: dict[str, Topic] = {}
    for entry in wanted:
        name, _, type_name = entry.partition(" ")
        known = BY_NAME.get(name.lstrip("/"))
        if type_name:
            chosen[name] = Topic(name, type_name.strip(), STREAM, 0.0, (), ())
        elif known is not None:
            chosen[known.name] = known
        else:
            known_names = ", ".join(BY_NAME)
            raise ConfigError("topic to record", expected=f"one of {known_names}, or a name with a type", got=name)
    return tuple(chosen.values()) or TOPICS


def _recorded(name: str, topic: Topic) -> RecordedTopic:
    return RecordedTopic(name=name, type=message_type(topic.type), qos=(_in_words(publisher_qos(topic)),))


def _in_words(profile: QoSProfile) -> Qos:
    return Qos(history=profile.history.short_key, depth=profile.depth, reliability=profile.reliability.short_key,
               durability=profile.durability.short_key)


def main() -> int:
    """Run the recorder."""
    return run_node(RecorderNode)


if __name__ == "__main__":
    raise SystemExit(main())
