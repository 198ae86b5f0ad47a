"""The corridor in process, as a Gymnasium environment: the oracle that the player is held against."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from corridor_server.corridor import world
from corridor_server.corridor.areas import NAME
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.corridor.drawing import top_view
from corridor_server.corridor.parameters import EpisodeParameters
from corridor_server.corridor.streams import area_generator
from corridor_server.shared.given import Range, shown

AREAS = Range(0, 2**31 - 1)
Observation = NDArray[np.float32]


class CorridorEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """The paper's motion-planning task: two agents in a corridor, a hidden switch, a target.

    From "Curiosity Driven Deep Reinforcement Learning for Motion Planning in Multi-agent Environment".

    ## Description

    Two agents share a corridor. The learner must turn on a switch, whose place it can't see, and then reach its
    target at the far end. The opponent comes the other way, straight to a target of its own, without looking.
    Motion is kinematic: spheres may overlap, which costs reward; walls stop the learner.

    ## Action space

    `Box(-1, 1, (2,), float32)`; values outside are clipped.

    | num | action | unit |
    |---|---|---|
    | 0 | wanted velocity along the corridor (x) | `agent_speed` (2 m/s) |
    | 1 | wanted velocity across it (z) | `agent_speed` (2 m/s) |

    Velocity follows with a time constant of `agent_time_constant` (0.5 s). A step is one decision: 5 physics steps of
    0.02 s.

    ## Observation space

    `Box(-inf, inf, (8 + 5K,), float32)` for K opponents (eq. 8 and 10; 13 for the paper's one). Lengths are in
    half-lengths of the corridor (10 m).

    | num | observation | unit | range |
    |---|---|---|---|
    | 0, 1 | position p (x, z) | half-lengths | -1 to 1 |
    | 2, 3 | velocity V (x, z) | half-lengths / s | -0.2 to 0.2 |
    | 4, 5 | target p_g (x, z) | half-lengths | -1 to 1 |
    | 6 | distance to the target d_g | half-lengths | 0 to 2.3 |
    | 7 | switch is on, sw_ind | - | 0 or 1 |
    | 8, 9 | opponent's position p_op (x, z) | half-lengths | -1 to 1 |
    | 10 | distance to the opponent d_op, centre to centre | half-lengths | 0 to 2.3 |
    | 11, 12 | opponent's velocity V_op (x, z) | half-lengths / s | -0.1 to 0.1 |

    8 to 12 repeat for each further opponent. Ranges are those of the default parameters.

    ## Rewards (eq. 9)

    The first that applies:

    | case | reward |
    |---|---|
    | the centre is within `goal_radius` of the target and the switch is on | +1 |
    | the step pushed the learner into a wall | -0.1 |
    | learner and opponent touch | -0.25 |
    | d_op < 0.2 | -0.1 - (1 - d_op) / 4 |
    | else | -0.001 |

    ## Starting state

    Learner at rest, x in [-4, -2] m, z in [-3, 3] m; opponent at x in [7, 8.5] m, z in [-3, 3] m; target at x = 9 m,
    z in [-3, 3] m; all uniform. The switch is off.

    ## Episode end

    Terminated when the target is reached with the switch on, or when the episode's rewards add up to -1 or less: then
    `failure_penalty` (1) is subtracted from the last reward. Truncated after `max_episode_steps` decisions, if set in
    the config.

    ## Info

    At an episode's end `info["statistics"]` has the values that the player sends over the statistics channel, by the
    names that they have there (`Corridor/Success` and others), and `info["is_success"]` says whether the target was
    reached.

    ## Arguments

    Args:
        render_mode: `rgb_array` or None; `render()` then draws the paper's Fig. 4(b).
        area: Which of a player's training areas this is: with the same seed, area i has the same episodes here.
        **parameters: Any field of `CorridorConfig` (docs/parameters.md), such as `opponent_speed=2.0`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 - Gymnasium's own declaration

    def __init__(self, render_mode: str | None = None, area: int = 0, **parameters: Any) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode is {shown(render_mode)}, but None or 'rgb_array' was expected.")
        number = AREAS.read(area, whole=True)
        if number is None:
            raise ValueError(f"area is {shown(area)}, but {AREAS.expected(whole=True)}.")
        self.render_mode = render_mode
        self.config = CorridorConfig.from_mapping(parameters)
        self.observation_space = spaces.Box(-np.inf, np.inf, (self.config.observation_size,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (world.ACTION_SIZE,), np.float32)
        self._area = int(number)
        self._p = EpisodeParameters(self.config, (self._area,)).columns
        self._state: world.State | None = None
        self._needs_reset = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode; with a seed, the first of that seed's.

        Args:
            seed: As the trainer gives it to a player. Without one, the stream goes on (at first, a random one).
            options: None are known.
        """
        if seed is not None or self._state is None:
            super().reset(seed=seed)
            # Not the property, whose setter forgets the seed that Gymnasium reports.
            self._np_random = area_generator(self.np_random_seed, self._area)
        self._needs_reset = False
        self._state = world.initial(self._p, self.config.num_opponents, [self.np_random])
        return world.observation(self._p, self._state)[0], {}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Applies an action for one decision.

        Raises:
            gymnasium.error.ResetNeeded: The episode is over, or never began.
            ValueError: The action is not two finite numbers.
        """
        if self._state is None or self._needs_reset:
            raise gymnasium.error.ResetNeeded("The episode is over or never began; call reset() before step().")
        try:
            numbers = np.asarray(action, dtype=np.float32)
        except (TypeError, ValueError, OverflowError):
            numbers = np.empty(0, np.float32)
        if numbers.shape != (world.ACTION_SIZE,) or not np.isfinite(numbers).all():
            raise ValueError(
                f"The action is {shown(action)}, but {world.ACTION_SIZE} finite numbers in [-1, 1] were expected."
            )
        self._state, outcome = world.step(self._p, self._state, numbers[None].astype(np.float64))
        info: dict[str, Any] = {}
        if outcome.ended[0]:
            self._needs_reset = True
            of_episode = world.statistics(self._state, outcome)
            statistics = {f"{NAME}/{name}": float(values[0]) for name, values in of_episode.items()}
            info = {"statistics": statistics, "is_success": bool(outcome.success[0])}
        truncated = bool(outcome.truncated[0])
        terminated = bool(outcome.ended[0]) and not truncated
        reward = float(np.float32(outcome.reward[0]))
        return world.observation(self._p, self._state)[0], reward, terminated, truncated, info

    @property
    def state(self) -> world.State:
        """Where everything is, what the observation hides included.

        Raises:
            gymnasium.error.ResetNeeded: No episode ever began.
        """
        if self._state is None:
            raise gymnasium.error.ResetNeeded("No episode ever began; call reset() first.")
        return self._state

    def render(self) -> NDArray[np.uint8] | None:
        """Draws the corridor from above, (264, 480, 3) uint8; None without a render mode."""
        if self.render_mode is None or self._state is None:
            return None
        return top_view(self._p, self._state, 0)
