"""Trains policies with the libraries imitation and stable-baselines3, in an environment of its own (`make policies`).

A request is one JSON object on standard input, its answer one on standard output; `policies.py` is the other end. This
file imports nothing of this package, and nothing else of the package imports it: the libraries' pins are not ours.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from imitation.algorithms import bc, preference_comparisons
from imitation.algorithms.adversarial.airl import AIRL
from imitation.data import types
from imitation.rewards.reward_nets import BasicRewardNet, BasicShapedRewardNet, NormalizedRewardNet
from imitation.rewards.reward_wrapper import RewardVecEnvWrapper
from imitation.util import logger as imitation_logger
from imitation.util.networks import RunningNorm
from numpy.typing import NDArray
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.vec_env import VecEnv

Array = NDArray[np.float64]
LENGTH = 0.5
"""Unit of positions in observations [m]."""


class ToolSpace:
    """A tool that is moved by a step of each coordinate at a time.

    Observed are its position beside the start and the share of the time that has passed; an action is the step as a
    share of the largest one.

    Attributes:
        start: Where the tool starts, shape (3,) [m].
        steps: Steps of a motion.
        largest: Largest step of a coordinate [m].
        box: Least and largest coordinates of the tool, shape (2, 3) [m]: a learned reward says nothing beyond.
        observations: Space of the observations.
        actions: Space of the actions.
    """

    def __init__(self, start: Array, steps: int, largest: float, box: Array) -> None:
        self.start, self.steps, self.largest, self.box = start, steps, largest, box
        self.observations = gymnasium.spaces.Box(-10.0, 10.0, (4,), np.float32)
        self.actions = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)

    def observed(self, positions: Array, passed: Array) -> NDArray[np.float32]:
        """Give observations of positions, shape (N, 3) [m], after steps that have passed, shape (N,)."""
        share = 2.0 * passed[:, None] / self.steps - 1.0
        return np.hstack([(positions - self.start) / LENGTH, share]).astype(np.float32)

    def moved(self, positions: Array, actions: Array) -> Array:
        """Give positions after actions, shape (N, 3) each."""
        return np.clip(positions + self.largest * np.clip(actions, -1.0, 1.0), *self.box)

    def shown(self, path: Array, passed: int = 0, *, whole: bool = True) -> types.Trajectory:
        """Read positions, shape (K, 3) [m], that a person moved the tool through, as observations and actions."""
        actions = np.clip(np.diff(path, axis=0) / self.largest, -1.0, 1.0).astype(np.float32)
        seen = self.observed(path, passed + np.arange(len(path), dtype=float))
        return types.Trajectory(obs=seen, acts=actions, infos=None, terminal=whole)

    def rolled_out(self, policy: BasePolicy, count: int, *, deterministic: bool) -> Array:
        """Let a policy move the tool from the start, `count` times at once; shape (count, steps + 1, 3) [m]."""
        positions = [np.tile(self.start, (count, 1))]
        for k in range(self.steps):
            actions, _ = policy.predict(self.observed(positions[-1], np.full(count, float(k))),
                                        deterministic=deterministic)
            positions.append(self.moved(positions[-1], actions))
        return np.stack(positions, axis=1)


class ToolEnv(VecEnv):
    """Many such tools at once, as the libraries want them. Nothing is rewarded: rewards are learned."""

    def __init__(self, space: ToolSpace, count: int) -> None:
        super().__init__(count, space.observations, space.actions)
        self._space = space
        self.reset()

    def reset(self) -> NDArray[np.float32]:
        """Begin anew."""
        self._positions, self._passed = np.tile(self._space.start, (self.num_envs, 1)), 0
        return self._seen()

    def _seen(self) -> NDArray[np.float32]:
        return self._space.observed(self._positions, np.full(self.num_envs, float(self._passed)))

    def step_async(self, actions: Array) -> None:
        """Take the next actions."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Move; all motions end together, after as many steps each."""
        self._positions = self._space.moved(self._positions, self._actions)
        self._passed += 1
        seen, done = self._seen(), self._passed == self._space.steps
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if done:
            infos = [{"terminal_observation": one, "TimeLimit.truncated": False} for one in seen]
            seen = self.reset()
        return seen, np.zeros(self.num_envs, np.float32), np.full(self.num_envs, done), infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Give an attribute once for each tool."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: nothing can be set."""
        raise NotImplementedError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: there are no single environments."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Say that nothing is wrapped."""
        return [False] * self.num_envs


def quiet() -> imitation_logger.HierarchicalLogger:
    """Give a logger that writes nothing."""
    return imitation_logger.configure(None, [])


def cloned(space: ToolSpace, request: Mapping[str, Any], rng: np.random.Generator) -> ActorCriticPolicy:
    """Clone what was shown: whole motions, and the spans that the person took over (human-gated)."""
    shown = [space.shown(np.asarray(path)) for path in request["demonstrations"]]
    shown += [space.shown(np.asarray(span["path"]), span["passed"], whole=False)
              for span in request.get("interventions", ())]
    settings, steps = request["settings"], sum(map(len, shown))
    policy = ActorCriticPolicy(space.observations, space.actions, lambda _: 1e-3, net_arch=[64, 64])
    trainer = bc.BC(observation_space=space.observations, action_space=space.actions, rng=rng, policy=policy,
                    demonstrations=shown, batch_size=max(1, min(steps, steps // settings["batches"])),
                    ent_weight=settings["entropy"], custom_logger=quiet(),
                    optimizer_kwargs={"lr": settings["learning_rate"]}, device="cpu")
    trainer.train(n_epochs=settings["epochs"], progress_bar=False, log_interval=10**9)
    return trainer.policy


def adversarial(space: ToolSpace, request: Mapping[str, Any], rng: np.random.Generator) -> ActorCriticPolicy:
    """Recover a reward from demonstrations against its own policy (AIRL), and give that policy."""
    settings = request["settings"]
    shown = [space.shown(np.asarray(path)) for path in request["demonstrations"]]
    venv = ToolEnv(space, settings["tools"])
    per_round = venv.num_envs * space.steps * settings["motions"]
    ppo = PPO("MlpPolicy", venv, seed=int(rng.integers(2**31)), device="cpu", n_steps=space.steps * settings["motions"],
              batch_size=settings["batch"], n_epochs=settings["epochs"], learning_rate=settings["learning_rate"],
              gamma=settings["discount"], gae_lambda=0.97, clip_range=0.2, ent_coef=settings["entropy"],
              policy_kwargs={"net_arch": [64, 64], "log_std_init": settings["log_std"]})
    reward = BasicShapedRewardNet(space.observations, space.actions, reward_hid_sizes=(100, 100),
                                  potential_hid_sizes=(100, 100), use_action=False,
                                  discount_factor=settings["discount"], normalize_input_layer=RunningNorm)
    if settings["clone"]:  # PPO begins from the demonstrations' policy
        bc.BC(observation_space=space.observations, action_space=space.actions, rng=rng, policy=ppo.policy,
              demonstrations=shown, batch_size=16, custom_logger=quiet(), device="cpu").train(
                  n_epochs=settings["clone"], progress_bar=False, log_interval=10**9)
    trainer = AIRL(demonstrations=shown, demo_batch_size=min(64, sum(map(len, shown))), venv=venv, gen_algo=ppo,
                   reward_net=reward, n_disc_updates_per_round=settings["discriminator_epochs"],
                   gen_replay_buffer_capacity=per_round, gen_train_timesteps=per_round, custom_logger=quiet(),
                   disc_opt_kwargs={"lr": settings["learning_rate"]})
    trainer.train(settings["rounds"] * per_round)
    return ppo.policy


def preferred(space: ToolSpace, request: Mapping[str, Any], rng: np.random.Generator) -> BasePolicy:
    """Learn a reward from ranked motions and maximise it with SAC, which begins from the demonstrations (Atari)."""
    settings = request["settings"]
    reward = ranked_reward(space, request, rng)
    venv = RewardVecEnvWrapper(ToolEnv(space, settings["tools"]), reward.predict_processed, ep_history=1)
    sac = SAC("MlpPolicy", venv, seed=int(rng.integers(2**31)), device="cpu", gamma=settings["discount"],
              learning_rate=settings["learning_rate"], batch_size=128, train_freq=1,
              ent_coef=f"auto_{settings['entropy']}",
              gradient_steps=settings["tools"], learning_starts=0,  # the clone explores, not chance
              policy_kwargs={"net_arch": [64, 64]})
    shown = [space.shown(np.asarray(path)) for path in request["demonstrations"]]
    _remember(sac, shown, reward)
    _pretrain(sac, shown, settings["clone"])
    sac.learn(settings["steps"])
    return sac.policy


def ranked_reward(space: ToolSpace, request: Mapping[str, Any], rng: np.random.Generator) -> NormalizedRewardNet:
    """Fit a reward to rankings; demonstrations are ranked over what the cloned policy does (automatic labels)."""
    settings = request["settings"]
    net = NormalizedRewardNet(BasicRewardNet(space.observations, space.actions, use_action=False,
                                             hid_sizes=(64, 64)), RunningNorm)
    data = preference_comparisons.PreferenceDataset()
    for better, worse in request["ranked"]:
        data.push([(_rewarded(space, better), _rewarded(space, worse))], np.array([1.0], dtype=np.float32))
    others = request["sampled"]
    for path in request["demonstrations"]:
        for k in rng.choice(len(others), min(settings["automatic"], len(others)), replace=False):
            data.push([(_rewarded(space, path), _rewarded(space, others[k]))], np.array([1.0], dtype=np.float32))
    if len(data):
        trainer = preference_comparisons.BasicRewardTrainer(
            preference_comparisons.PreferenceModel(net.base), preference_comparisons.CrossEntropyRewardLoss(), rng,
            batch_size=min(32, len(data)), epochs=settings["reward_epochs"], lr=1e-3, custom_logger=quiet())
        trainer.train(data)
    return net


def _rewarded(space: ToolSpace, path: Sequence[Sequence[float]]) -> types.TrajectoryWithRew:
    """Read a motion as the libraries' rankings want it: with the true reward, which nobody knows."""
    one = space.shown(np.asarray(path))
    return types.TrajectoryWithRew(obs=one.obs, acts=one.acts, infos=None, terminal=True,
                                   rews=np.zeros(len(one.acts), np.float32))


def _remember(sac: SAC, shown: Sequence[types.Trajectory], reward: NormalizedRewardNet) -> None:
    """Put what was shown into the replay buffer, as many times as there are tools."""
    assert sac.replay_buffer is not None
    for one in shown:
        for k, action in enumerate(one.acts):
            before, after, last = one.obs[k], one.obs[k + 1], k + 1 == len(one.acts)
            rows = [np.repeat(x[None], sac.n_envs, axis=0) for x in (before, after, action)]
            value = reward.predict_processed(rows[0], rows[2], rows[1], np.full(sac.n_envs, last), update_stats=False)
            sac.replay_buffer.add(*rows, value, np.full(sac.n_envs, last), [{}] * sac.n_envs)


def _pretrain(sac: SAC, shown: Sequence[types.Trajectory], steps: int) -> None:
    """Bring the actor to what was shown."""
    seen = torch.as_tensor(np.concatenate([one.obs[:-1] for one in shown]))
    done = torch.as_tensor(np.concatenate([one.acts for one in shown]))
    optimiser = torch.optim.Adam(sac.actor.parameters(), lr=1e-3)
    for _ in range(steps):
        loss = ((sac.actor(seen, deterministic=True) - done)**2).mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


TRAINERS: Mapping[str, Callable[[ToolSpace, Mapping[str, Any], np.random.Generator], BasePolicy]] = {
    "BC": cloned, "AIRL": adversarial, "Atari": preferred,
}


def answer(request: Mapping[str, Any]) -> dict[str, Any]:
    """Train as asked; give the policy's motion, and samples of it."""
    began = time.process_time()
    torch.manual_seed(request["seed"])
    np.random.seed(request["seed"])  # noqa: NPY002  the libraries draw from it
    space = ToolSpace(np.asarray(request["start"]), request["steps"], request["largest"], np.asarray(request["box"]))
    policy = TRAINERS[request["method"]](space, request, np.random.default_rng(request["seed"]))
    policy.set_training_mode(False)
    return {"motion": space.rolled_out(policy, 1, deterministic=True)[0].tolist(),
            "samples": space.rolled_out(policy, request["samples"], deterministic=False).tolist()
            if request["samples"] else [], "seconds": time.process_time() - began}


def main() -> None:
    """Answer requests until standard input ends."""
    torch.set_num_threads(1)
    answers, sys.stdout = sys.stdout, sys.stderr  # what the libraries print is no answer
    for line in sys.stdin:
        try:
            reply = answer(json.loads(line))
        except Exception as error:  # the other end says what failed
            reply = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(reply), file=answers, flush=True)


if __name__ == "__main__":
    main()
