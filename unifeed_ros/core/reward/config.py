"""Settings and figures of a training, apart from it: who only names them need not wait for torch to load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.reward.activations import require_activation
from unifeed_ros.core.reward.buffer import AlternativesConfig
from unifeed_ros.core.reward.ensemble import RATIONALITY, RewardEnsemble
from unifeed_ros.core.reward.features import feature_name
from unifeed_ros.core.reward.reliability import ESTIMATE, check_reliability


@dataclass(frozen=True, kw_only=True)
class TrainingConfig:
    """Settings of the reward ensemble's training."""

    members: int = 8
    """Number of networks, at least 2 (disagreement needs two). More than the paper's three because the mean of three
    plans differently from seed to seed; with the smaller batch that each then sees, a step costs the same."""
    hidden: Sequence[int] = (48, 48)
    """Widths of the hidden layers. Wider ones need more steps for as good a plan, and each takes longer."""
    activation: str = "leaky_relu"
    """Activation of the hidden layers: leaky_relu, leaky_softplus (without its kink) or tanh, whose
    members saturate and die at the learning rate of the others: give it 3e-3."""
    features: Sequence[str] = ()
    """Features that are given, such as "distance(goal)", "height(0.0)" or "near_xy(person, 0.4)"; none: the reward is
    learned from scratch. Kinds: distance, distance_xy, near, near_xy, near_box, height, tilt, and those of entry points
    in the group unifeed_ros.features."""
    rationality: float = RATIONALITY
    """How strongly returns decide a comparison, beta of the Luce choice rule [1/reward]."""
    waypoints: int = 20
    """States H that a motion is compared by; the planner should use as many."""
    demonstration_comparisons: int = 200
    """Weight of eq. M4 in the sum N_d."""
    correction_comparisons: int = 150
    """Weight of eq. M5 in the sum N_c. Somewhat less than a demonstration's, because a correction says nothing of the
    rest of the motion and of how fast it should be; much less, and what was pushed away comes back."""
    preference_comparisons: int = 5
    """Weight of eq. M6 in the sum N_q: how often each ranked pair stands in the buffer. Less than the others because
    the better of two motions, unlike what was shown, need not be good, and because questions are about near motions,
    which a person often ranks wrongly: one such answer, repeated, bends the reward until it agrees."""
    reliability: str | Sequence[float] = ESTIMATE
    """How far each kind of feedback is trusted, a factor on its weight: "estimate", from how it agrees with the others,
    or fixed factors of demonstrations, corrections and preferences, 0 to 1 [1]."""
    pool: int = 1000
    """Alternatives drawn of each demonstration and each correction, which the steps choose from. More than the paper's
    N_d and N_c, which stay the weights: what 200 of them happened to leave out differs from seed to seed by more than
    a correction teaches, and all members share it, so that more members do not help against it."""
    compared_waypoints: int = 5
    """About how many of a motion's states one step compares: every k-th, the first one drawn anew in each step."""
    batch: int = 24
    """Alternatives that each member sees in one step, shared evenly by demonstrations and corrections."""
    steps: int = 200
    """Steps of the optimiser from scratch."""
    learning_rate: float = 1e-2
    """Learning rate at the start; it falls to zero along a half cosine."""
    weight_penalty: float = 1e-3
    """Weight of the sum of squared weights of each member."""
    residual_penalty: float = 0.01
    """The same where features are given: what they explain is left to them. Ten times more, and the network no longer
    learns what they cannot explain."""
    warm_steps: int = 80
    """Steps when going on from the previous model; 0: always from scratch. It is gone on from as it is: mixed with new
    weights (shrunk and perturbed), it planned worse after as many steps."""
    warm_learning_rate: float = 4e-3
    """Learning rate at the start when going on from the previous model."""
    alternatives: AlternativesConfig = field(default_factory=AlternativesConfig)
    """How alternatives are drawn."""

    def __post_init__(self) -> None:
        """Reject values that would only fail in the middle of a lesson."""
        object.__setattr__(self, "hidden", tuple(int(w) for w in self.hidden))
        object.__setattr__(self, "reliability", check_reliability(self.reliability))
        object.__setattr__(self, "features", tuple(map(feature_name, self.features)))
        if len(set(self.features)) < len(self.features):
            raise ConfigError("features", expected="each once", got=", ".join(self.features))
        least = {"members": 2, "waypoints": 4, "demonstration_comparisons": 1, "correction_comparisons": 1,
                 "preference_comparisons": 1, "pool": 1, "compared_waypoints": 1,
                 "batch": 1, "steps": 1, "warm_steps": 0}
        for name, bound in least.items():
            if getattr(self, name) < bound:
                raise ConfigError(name, expected=f"at least {bound}", got=getattr(self, name))
        require_activation(self.activation)
        if not self.hidden or min(self.hidden) < 1:
            raise ConfigError("hidden", expected="widths of at least 1", got=self.hidden)
        for name in ("learning_rate", "warm_learning_rate"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigError(name, expected="above 0 and below 1", got=getattr(self, name))
        if not 0.0 < self.rationality < float("inf"):
            raise ConfigError("rationality", expected="above 0", got=self.rationality)
        for name in ("weight_penalty", "residual_penalty"):
            if not getattr(self, name) >= 0.0:
                raise ConfigError(name, expected="not negative", got=getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """A trained ensemble and how the training went."""

    ensemble: RewardEnsemble
    """The networks."""
    seconds: float
    """Wall-clock time [s]."""
    steps: int
    """Steps of the optimiser."""
    loss_demonstrations: float
    """Mean cross-entropy of a comparison with a demonstration, eq. M4 [nat]."""
    loss_corrections: float
    """Mean cross-entropy of a comparison with a correction, eq. M5 [nat]."""
    loss_preferences: float
    """Mean cross-entropy of a ranked pair, eq. M6 [nat]."""
    accuracy: float
    """Share of fresh comparisons that the ensemble's mean decides as the person did, 0 to 1."""
    reliability: tuple[float, float, float]
    """How far demonstrations, corrections and preferences were trusted, 0 to 1."""
