"""What a scene may have that nothing here learns from: it ends the run where it first shows, and is never left out."""

from collections.abc import Collection

import numpy as np
from mlagents_envs.base_env import DecisionSteps

from trainer.errors import TrainerError

ELSEWHERE = "train this scene with mlagents-learn"


def refuse_other_behaviors(behaviors: Collection[str], own: str) -> None:
    """Refuses agents of another behavior, which may come late.

    Raises:
        TrainerError: There are such.
    """
    if len(behaviors) > 1:
        others = ", ".join(name for name in behaviors if name != own)
        raise TrainerError(
            f"Agents of behavior {others} have come beside those of {own}, but one behavior can be trained; give all "
            f"agents the same Behavior Name and team, or {ELSEWHERE}."
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
                f"Agent {decision.agent_id[row]} masks choice {choice} of discrete branch {branch}, but masks can't be "
                f"kept to; let the scene take every choice, or {ELSEWHERE}."
            )
