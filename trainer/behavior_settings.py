"""How one behavior is trained: a behavior's section of ``mlagents-learn``'s YAML, with ML-Agents' names and defaults.

Names, defaults and what follows from what are those of mlagents 1.1.0; ranges are ours, where ML-Agents has none. Of
what its YAML can say besides, these change nothing, and are taken and left out: ``framework`` (there is one), and the
``network_settings`` of the extrinsic reward (it has no network). The rest is refused, unless it is null or false, as in
a file that ``mlagents-learn`` wrote.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, Self

from corridor_server.shared.given import Range, shown
from trainer.errors import SettingError
from trainer.options import Count, Positive, Settings, Share, Steps, Units, names_and_values

TrainerType = Literal["ppo", "sac"]
Schedule = Literal["constant", "linear"]
EncoderType = Literal["simple", "nature_cnn", "resnet", "match3", "fully_connected"]
Above = Annotated[float, Range(1e-9, 10**9, otherwise="a number above 0 was expected")]


@dataclass(frozen=True)
class NetworkSettings(Settings):
    """A network's body.

    Attributes:
        normalize: Normalise vector observations by their running mean and variance.
        hidden_units: Units in each hidden layer.
        num_layers: Hidden layers.
        vis_encode_type: The encoder of pictures.
        goal_conditioning_type: Whether goal signals are the input of a hypernetwork, or beside other observations.
        deterministic: Take the most likely actions instead of drawing them.
    """

    SECTION: ClassVar = "network_settings"
    NOT_HERE: ClassVar = {"memory": "there are no recurrent networks here; take memory out, and stack observations"}
    normalize: bool = False
    hidden_units: Units = 128
    num_layers: Annotated[int, Range(1, 32)] = 2
    vis_encode_type: EncoderType = "simple"
    goal_conditioning_type: Literal["hyper", "none"] = "hyper"
    deterministic: bool = False


@dataclass(frozen=True)
class RewardSignal(Settings):
    """One reward; the extrinsic one has no more.

    Attributes:
        strength: Factor on it.
        gamma: Its discount factor.
    """

    SECTION: ClassVar = "a reward signal"
    NO_EFFECT: ClassVar = {"network_settings": NetworkSettings}
    strength: Positive = 1.0
    gamma: Share = 0.99


@dataclass(frozen=True)
class _LearnedSignal(RewardSignal):
    """A reward that networks of its own give.

    Attributes:
        learning_rate: Their Adam's.
        network_settings: Their body.
    """

    NO_EFFECT: ClassVar = {}
    learning_rate: Positive = 3e-4
    network_settings: NetworkSettings = NetworkSettings()

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings; ``encoding_size``, of versions before, stands for ``network_settings.hidden_units``.

        Raises:
            SettingError: Something in it can't be used, or the two contradict each other.
        """
        given = dict(names_and_values(values, cls.SECTION))
        size = given.pop("encoding_size", None)
        if size is None:
            return super().from_mapping(given)
        given.setdefault("network_settings", {"hidden_units": size})
        signal = super().from_mapping(given)
        if signal.network_settings.hidden_units != size:
            raise SettingError(
                f"encoding_size is {shown(size)}, but network_settings.hidden_units, which has taken its place, is "
                f"{signal.network_settings.hidden_units}; take encoding_size out.",
                "encoding_size",
            )
        return signal


@dataclass(frozen=True)
class CuriositySignal(_LearnedSignal):
    """Curiosity: what a forward model did not foresee (ICM)."""

    SECTION: ClassVar = "curiosity"


@dataclass(frozen=True)
class RNDSignal(_LearnedSignal):
    """Random network distillation: what a network can't say yet of a random one."""

    SECTION: ClassVar = "rnd"
    learning_rate: Positive = 1e-4


@dataclass(frozen=True)
class RewardSignals(Settings):
    """The rewards that a behavior learns from; None is not there.

    Attributes:
        extrinsic: The environment's.
        curiosity: For what could not be foreseen.
        rnd: For what is new.
    """

    SECTION: ClassVar = "reward_signals"
    NOT_HERE: ClassVar = {"gail": "nothing is learned from demonstrations here; take gail out"}
    extrinsic: RewardSignal | None = RewardSignal()
    curiosity: CuriositySignal | None = None
    rnd: RNDSignal | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.extrinsic is None and self.curiosity is None and self.rnd is None:
            raise SettingError("reward_signals has no signal; give extrinsic, curiosity or rnd.")

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings, but that only what is named is there: curiosity alone leaves the extrinsic reward out.

        Raises:
            SettingError: Something in it can't be used, or none is named.
        """
        signals = super().from_mapping(values)
        return signals if "extrinsic" in names_and_values(values, "") else replace(signals, extrinsic=None)


@dataclass(frozen=True)
class PPOHyperparameters(Settings):
    """Of PPO.

    Attributes:
        batch_size: Steps in a minibatch.
        buffer_size: Steps in an update.
        learning_rate: Adam's, at the beginning.
        learning_rate_schedule: Whether it goes to 0 over the run; in a file, the other schedules follow it.
        beta: Weight of the entropy bonus, at the beginning.
        beta_schedule: Whether it goes to 1e-5.
        epsilon: How far a policy may move in an update, at the beginning.
        epsilon_schedule: Whether it goes to 0.1.
        lambd: Generalised advantage estimation's lambda.
        num_epoch: Passes over an update's steps.
        shared_critic: Whether the critic is a head on the actor's body.
        value_heads: A value head and discount factor for each reward signal, as ML-Agents has it, or ``one``: all
            rewards are added up before it, as the paper has it, with the discount factor of the extrinsic one.
    """

    SECTION: ClassVar = "hyperparameters"
    batch_size: Count = 1024
    buffer_size: Count = 10240
    learning_rate: Positive = 3e-4
    learning_rate_schedule: Schedule = "linear"
    beta: Positive = 5e-3
    beta_schedule: Schedule = "linear"
    epsilon: Positive = 0.2
    epsilon_schedule: Schedule = "linear"
    lambd: Share = 0.95
    num_epoch: Count = 3
    shared_critic: bool = False
    value_heads: Literal["per_signal", "one"] = "per_signal"

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_batch(self.batch_size, self.buffer_size)

    def as_dict(self) -> dict[str, Any]:
        """As of any settings; ``value_heads``, which mlagents-learn has not, only where it differs from it."""
        values = super().as_dict()
        if self.value_heads == "per_signal":
            del values["value_heads"]
        return values

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings, but that the schedules of beta and epsilon follow the learning rate's.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        if "learning_rate_schedule" in given:
            super().from_mapping({"learning_rate_schedule": given["learning_rate_schedule"]})  # its own line, if wrong
            for other in ("beta_schedule", "epsilon_schedule"):
                given.setdefault(other, given["learning_rate_schedule"])
        return super().from_mapping(given)


@dataclass(frozen=True)
class SACHyperparameters(Settings):
    """Of SAC.

    Attributes:
        batch_size: Steps in a minibatch.
        buffer_size: Steps in the replay buffer.
        learning_rate: Adam's, at the beginning.
        learning_rate_schedule: Whether it goes to 0 over the run.
        buffer_init_steps: Steps before the first update.
        tau: How far the target network moves in an update.
        steps_per_update: Agent steps to each update.
        save_replay_buffer: Keep the buffer in checkpoints; without it, a resumed run begins with an empty one, and
            learns on once that has a minibatch.
        init_entcoef: The entropy coefficient at the beginning.
        reward_signal_steps_per_update: Agent steps to each update of reward signals; in a file, ``steps_per_update``
            if it is not given.
    """

    SECTION: ClassVar = "hyperparameters"
    batch_size: Count = 128
    buffer_size: Count = 50000
    learning_rate: Positive = 3e-4
    learning_rate_schedule: Schedule = "constant"
    buffer_init_steps: Annotated[int, Range(0, 10**9)] = 0
    tau: Share = 0.005
    steps_per_update: Above = 1.0
    save_replay_buffer: bool = False
    init_entcoef: Above = 1.0
    reward_signal_steps_per_update: Above = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_batch(self.batch_size, self.buffer_size)

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings, but that the reward signals' steps follow the policy's.

        Raises:
            SettingError: Something in it can't be used.
        """
        settings = super().from_mapping(values)
        if "reward_signal_steps_per_update" in names_and_values(values, ""):
            return settings
        return replace(settings, reward_signal_steps_per_update=settings.steps_per_update)


def _check_batch(batch_size: int, buffer_size: int) -> None:
    if batch_size > buffer_size:
        raise SettingError(
            f"The setting batch_size is {batch_size}, but buffer_size is {buffer_size}, and a minibatch is drawn from "
            "the buffer; make batch_size at most buffer_size.",
            "batch_size",
        )


Hyperparameters = PPOHyperparameters | SACHyperparameters
HYPERPARAMETERS: dict[TrainerType, type[Hyperparameters]] = {"ppo": PPOHyperparameters, "sac": SACHyperparameters}


@dataclass(frozen=True)
class BehaviorSettings(Settings):
    """How a behavior is trained.

    Attributes:
        trainer_type: The learning algorithm.
        hyperparameters: Its own.
        network_settings: The body of actor and critic.
        reward_signals: What it learns from.
        init_path: A checkpoint that it begins with.
        keep_checkpoints: The newest ones, which are kept.
        checkpoint_interval: Steps between two.
        even_checkpoints: Whether that follows: as many steps as make ``keep_checkpoints`` of them in the run.
        max_steps: Steps to train for.
        time_horizon: Steps of an agent after which its experience is used, though its episode goes on.
        summary_freq: Steps between two reports.
        threaded: Whether PPO's updates run beside the next steps, which the policy before them decides.
    """

    SECTION: ClassVar = "a behavior"
    NOT_HERE: ClassVar = {
        "self_play": "no team plays against its past policies here; take self_play out",
        "behavioral_cloning": "nothing is learned from demonstrations here; take behavioral_cloning out",
    }
    NO_EFFECT: ClassVar = {"framework": str}
    trainer_type: TrainerType = "ppo"
    hyperparameters: Hyperparameters = PPOHyperparameters()
    network_settings: NetworkSettings = NetworkSettings()
    reward_signals: RewardSignals = RewardSignals()
    init_path: str | None = None
    keep_checkpoints: Count = 5
    checkpoint_interval: Count = 500_000
    even_checkpoints: bool = False
    max_steps: Steps = 500_000
    time_horizon: Count = 64
    summary_freq: Count = 50_000
    threaded: bool = False

    def __post_init__(self) -> None:
        """Refuses values of another type or out of their range.

        Raises:
            SettingError: The first of them.
        """
        super().__post_init__()
        if not isinstance(self.hyperparameters, HYPERPARAMETERS[self.trainer_type]):
            raise SettingError(f"trainer_type is {self.trainer_type}, but hyperparameters are another's.")
        if self.even_checkpoints:
            object.__setattr__(self, "checkpoint_interval", max(1, self.max_steps // self.keep_checkpoints))

    @classmethod
    def from_mapping(cls, values: object) -> Self:
        """As of any settings, but that hyperparameters are those of the trainer type.

        Raises:
            SettingError: Something in it can't be used.
        """
        given = dict(names_and_values(values, cls.SECTION))
        trainer_type = given.get("trainer_type", "ppo")
        if trainer_type in ("ppo", "sac"):  # or it is refused
            try:
                given["hyperparameters"] = HYPERPARAMETERS[trainer_type].from_mapping(given.get("hyperparameters", {}))
            except SettingError as error:
                raise error.within("hyperparameters") from error
        return super().from_mapping(given)
