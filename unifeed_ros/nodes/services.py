"""The table of services and actions: names, types, who offers them, what an empty request does."""

from __future__ import annotations

from dataclasses import dataclass

TRIGGER = "std_srvs/srv/Trigger"


@dataclass(frozen=True)
class Service:
    """One service or action of a session."""

    name: str
    """Name, relative."""

    type: str
    """Type, as "package/srv/Type" or "package/action/Type"."""

    node: str
    """Node that offers it."""

    empty: str
    """What an empty request does, as a sentence."""

    @property
    def is_action(self) -> bool:
        """True for an action, False for a service."""
        return "/action/" in self.type


SERVICES: tuple[Service, ...] = (
    Service("train_reward", "unifeed_msgs/srv/TrainReward", "reward_learner",
            "Trains on everything that was taught and answers with the figures of the training."),
    Service("evaluate_reward", "unifeed_msgs/srv/EvaluateReward", "reward_learner",
            "Refused with a message: a motion is needed; its empty context means the learner's own."),
    Service("select_query", "unifeed_msgs/srv/SelectQuery", "reward_learner",
            "Chooses among past motions and variations of them, in the learner's own context."),
    Service("answer_query", "unifeed_msgs/srv/AnswerQuery", "reward_learner",
            'Answers the newest query with "neither", from which nothing is learned.'),
    Service("rank_motions", "unifeed_msgs/srv/RankMotions", "reward_learner",
            "Refused with a message: names of motions are needed; the answer lists those that are known."),
    Service("undo_feedback", "unifeed_msgs/srv/UndoFeedback", "reward_learner", "Takes the newest input back."),
    Service("list_feedback", "unifeed_msgs/srv/ListFeedback", "reward_learner", "Lists every input, oldest first."),
    Service("optimize_trajectory", "unifeed_msgs/action/OptimizeTrajectory", "trajectory_optimizer",
            "Plans the task's motion, from its start to its goal, with the newest reward."),
    Service("execute_trajectory", "unifeed_msgs/action/ExecuteTrajectory", "shared_control",
            "Refused with a message: a motion is needed."),
    Service("set_mode", "unifeed_msgs/srv/SetMode", "shared_control", "The arm holds where it is."),
    Service("stop", TRIGGER, "shared_control", "Stops the arm at once; set_mode or the session's reset ends it."),
    Service("start_demonstration", TRIGGER, "session", "Makes the arm weightless, for guiding."),
    Service("finish_demonstration", TRIGGER, "session", "Ends the guiding, learns from it and shows the new motion."),
    Service("run", TRIGGER, "session", "Carries the newest motion out; a push becomes a correction."),
    Service("pause", TRIGGER, "session", "Breaks the present step off; the arm holds; run or reset goes on."),
    Service("ask", TRIGGER, "session", "Shows two motions and asks which one was better."),
    Service("save", TRIGGER, "session", "Writes the learned reward to a file and answers with its path."),
    Service("reset", TRIGGER, "session", "Goes back to the start, also after a fault; what was taught is kept."),
    Service("take_control", "unifeed_msgs/srv/TakeControl", "session",
            "Changes nothing; the answer says which page or terminal has control."),
    Service("split", TRIGGER, "recorder", "Ends the present file of the bag and goes on in the next one."),
    Service("mark", "unifeed_msgs/srv/Mark", "recorder", 'Writes the mark "mark" into the recording.'),
)
