"""What agents that are trained in lockstep may not have: it ends the run where it first shows, and is not left out."""

from collections.abc import Collection

import numpy as np
from mlagents_envs.base_env import DecisionSteps

from trainer.errors import TrainerError

# What trains or plays several behaviors, whoever it is that takes one.
SEVERAL = (
    "give all agents the same Behavior Name and team, train with a CONFIG.yaml that has default_settings, or take "
    "UnityParallelEnv"
)


def refuse_other_behaviors(behaviors: Collection[str], own: str) -> None:
    """Refuses agents of another behavior, which may come late.

    Raises:
        TrainerError: There are such.
    """
    if len(behaviors) > 1:
        others = ", ".join(name for name in behaviors if name != own)
        raise TrainerError(
            f"Agents of behavior {others} have come beside those of {own}, but one behavior was expected; {SEVERAL}."
        )


def refuse_masks(decision: DecisionSteps) -> None:
    """Refuses masks that forbid a choice: the policy would take it all the same.

    Raises:
        TrainerError: There is one.
    """
    for branch, mask in enumerate(decision.action_mask or ()):
        if np.count_nonzero(mask):
            row, choice = np.argwhere(mask)[0].tolist()
            raise TrainerError(
                f"Agent {decision.agent_id[row]} masks choice {choice} of discrete branch {branch}, but a run with "
                "--preset, --algo or --from-sb3 can't keep to masks; leave these options out."
            )
