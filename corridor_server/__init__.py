"""The paper's corridor as a player that speaks the ML-Agents protocol, and as a Gymnasium environment.

``protocol`` knows messages and agents, and no simulation; ``corridor`` is the simulation, and knows no message.
``player`` brings them together: ``corridor_config`` -> ``world`` -> ``areas`` -> agents -> ``wire`` -> ``connection``.
``corridor.gym_env`` is the same world in process, and the oracle that the player is tested against.
"""

import sys
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType


def _register() -> None:
    from gymnasium.envs.registration import register

    from corridor_server.corridor.curious_corridor import as_a_player_has_it

    entry_point = "corridor_server.corridor.gym_env:CorridorEnv"
    register(id="Corridor-v0", entry_point=entry_point)
    register(id="CuriousCorridor-v0", entry_point=entry_point, kwargs=as_a_player_has_it())


class _RegisterWithGymnasium:
    """Registers both corridors once somebody imports Gymnasium, which takes long and is not needed by all."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Gymnasium's own, whose end is awaited; None of all else."""
        if name != "gymnasium":
            return None
        spec = PathFinder.find_spec(name, path)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                _register()

            vars(spec.loader)["exec_module"] = execute_and_register
        return spec


if sys.modules.get("gymnasium") is not None:  # gymnasium.make("corridor_server:Corridor-v0") imports this
    _register()
else:
    sys.meta_path.insert(0, _RegisterWithGymnasium())
