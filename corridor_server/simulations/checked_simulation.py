"""Any simulation as the player has it: what it raises is blamed on it, and what it gives is checked."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Behavior
from corridor_server.protocol.samplers import Value
from corridor_server.shared.given import shown
from corridor_server.simulations.given_moments import check_behavior, read_moment, read_told
from corridor_server.simulations.simulation import (
    Moment,
    NotRestored,
    Simulation,
    SimulationError,
    Statistics,
    blaming,
    try_to_close,
)


class CheckedSimulation(Simulation):
    """Plays another one, of which anything may be wrong. One that checks itself is spared the checks, which cost time.

    Args:
        make: Makes it.

    Raises:
        SimulationError: It can't be made, or a behavior can't be carried. Whatever else is wrong raises it later.
    """

    def __init__(self, make: Callable[[], Simulation]) -> None:
        with blaming("The simulation can't be made"):
            self._simulation = make()
            if not isinstance(self._simulation, Simulation):
                raise SimulationError(f"make_simulation gave {shown(self._simulation)}, but a Simulation was expected.")
        self._checks = not self._simulation.is_checked
        self._declared: dict[str, Behavior] = {}
        try:
            self._follow()
        except SimulationError:
            self.close()
            raise

    @property
    def behaviors(self) -> Mapping[str, Behavior]:
        """All that there have been."""
        return self._declared if self._checks else self._simulation.behaviors

    def reset(self) -> Moment:
        """Begins an episode everywhere."""
        with blaming("The simulation failed in a reset"):
            moment = self._simulation.reset()
        self._follow()
        if not self._checks:
            return moment
        with blaming("The simulation's reset gave what can't be used"):
            return read_moment(moment, self._declared, "reset")

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[Moment, Statistics]:
        """Goes on until the next moment."""
        with blaming("The simulation failed in a step"):
            told = self._simulation.step(actions)
        self._follow()
        if not self._checks:
            return told
        with blaming("The simulation's step gave what can't be used"):
            return read_told(told, self._declared)

    def set_parameter(self, name: str, value: Value) -> None:
        """Sets an environment parameter."""
        with blaming(f"The simulation failed when {name} was set", ValueError):
            self._simulation.set_parameter(name, value)
        self._follow()

    def snapshot(self) -> NDArray[np.void] | None:
        """All that decides what happens from here on."""
        with blaming("The simulation failed when its state was saved"):
            rows = self._simulation.snapshot()
        if rows is not None and (not isinstance(rows, np.ndarray) or not rows.ndim or rows.dtype.hasobject):
            raise SimulationError(
                f"The simulation's snapshot gave {shown(rows)}, but an array of rows of numbers was expected, or None."
            )
        return rows

    def forgo_snapshots(self) -> None:
        """Is told that nothing has to be kept."""
        with blaming("The simulation failed when it was told that no state will be saved"):
            self._simulation.forgo_snapshots()

    def restore(self, rows: NDArray[np.void]) -> None:
        """Takes up a saved state."""
        with blaming("The simulation failed when its state was put back", NotRestored):
            self._simulation.restore(rows)
        self._follow()

    def close(self) -> None:
        """Ends it; that it can't be ended does no harm."""
        try_to_close("The simulation", self._simulation.close)

    def _follow(self) -> None:
        """Takes over what it says of itself, which may have changed."""
        self.restored, self.acts_when_idle = self._simulation.restored, self._simulation.acts_when_idle
        if not self._checks:
            return
        with blaming("The simulation doesn't say what its behaviors are"):
            for name, behavior in self._simulation.behaviors.items():
                known = self._declared.get(name)
                if known is None:
                    check_behavior(name, behavior)
                    self._declared[name] = behavior
                elif known is not behavior and known != behavior:
                    raise SimulationError(
                        f"Behavior {name} is another one than before, but a trainer is told of each only once; give it "
                        "another name."
                    )
