"""The life of a player: handshake, then reset and step until the trainer has had enough (protocol.md of ML-Agents)."""

import logging
from collections.abc import Callable
from typing import Any

from corridor_server.connection import Connection, ConnectionBroken, ConnectionFailed
from corridor_server.decision_timing import TIMINGS, Timing
from corridor_server.protocol import side_channels, wire
from corridor_server.protocol.messages import API_VERSION, QUIT
from corridor_server.protocol.side_channels import SideChannelError
from corridor_server.protocol.visual_observations import PictureForm
from corridor_server.shared.given import MAX_AREAS
from corridor_server.simulations.checked_simulation import CheckedSimulation
from corridor_server.simulations.simulation import NotRestored, Simulation, SimulationError, blaming

logger = logging.getLogger(__name__)

FAREWELL_SECONDS = 1.0
MakeSimulation = Callable[[int, int], Simulation]  # from a seed, an int32, and how many areas are wanted


class PlayerError(Exception):
    """The player can't go on; the message is for the user."""


class Player:
    """Serves a simulation to one trainer.

    Args:
        connection: An open connection.
        make_simulation: Makes it, from a seed, an int32, and the number of training areas, once both are known.
        package_version: Announced in the handshake.
        seed: Used instead of the trainer's seed, if given.
        num_areas: Used where the trainer asks for one area or, as old ones do, for none.
        compressed: Send pictures as PNG instead of floats.
        decision_timing: ``together`` or ``unity`` (see ``decision_timing``).
    """

    def __init__(
        self,
        connection: Connection,
        make_simulation: MakeSimulation,
        package_version: str,
        seed: int | None = None,
        num_areas: int | None = None,
        compressed: bool = True,
        decision_timing: str = "together",
    ) -> None:
        self._connection = connection
        self._make_simulation = make_simulation
        self._package_version = package_version
        self._seed = seed
        self._num_areas = num_areas
        self._compressed = compressed
        self._timing = TIMINGS[decision_timing]
        self._refused = False  # whether a state could not be put back, of which the trainer was not told yet

    def run(self) -> None:
        """Plays until the trainer ends it with QUIT or a status other than 200.

        Raises:
            PlayerError: The trainer's protocol version, or a message of its, can't be used; the trainer was told so.
            ConnectionBroken: The trainer is gone.
            ConnectionFailed: There is no trainer to play with.
            SimulationError: The simulation failed, or gave what can't be used; the trainer was told that the player
            stops.
        """
        try:
            self._play()
        except (wire.WireError, SideChannelError) as error:
            self.say_farewell()
            raise PlayerError(str(error)) from error
        except (PlayerError, SimulationError):
            self.say_farewell()
            raise

    def say_farewell(self) -> None:
        """Tells the trainer that the player stops (status 400); a trainer that is busy or gone is not waited for."""
        try:
            self._connection.exchange(wire.farewell(), timeout=FAREWELL_SECONDS)
        except ConnectionFailed as error:
            logger.debug("%s", error)

    def _play(self) -> None:
        parameters = wire.parameters(self._shake_hands(wire.hello(self._package_version)))
        if parameters is None:
            return
        simulation = self._simulation(parameters)
        try:
            self._serve(simulation, parameters)
        finally:
            simulation.close()
        logger.info("The trainer ended the session.")

    def _serve(self, simulation: Simulation, parameters: Any) -> None:
        timing: Timing = self._timing(simulation)
        can = parameters.capabilities
        mapped = can.concatenatedPngObservations and can.compressedChannelMapping
        form = PictureForm(self._compressed, _wants_channels_first(parameters.package_version), mapped)
        reply = self._shake_hands(wire.acknowledgement())
        introduced: set[str] = set()
        asked: dict[str, int] | None = None  # how many agents want an action; nobody was heard of yet
        state_wanted = False
        while (command := wire.command(reply, simulation.behaviors, asked)).number != QUIT:
            if asked is None and side_channels.AREA_STATE not in dict(side_channels.split(command.side_channel)):
                simulation.forgo_snapshots()
            state_wanted |= self._apply_side_channels(simulation, command.side_channel)
            if command.actions is None:  # a RESET, or a STEP before the first one
                moment, statistics = timing.reset()
            else:
                moment, statistics = timing.step(command.actions)
            parts = [(simulation.behaviors[name], agents) for name, agents in moment.items() if len(agents)]
            asked = {behavior.name: len(agents.deciding) for behavior, agents in parts}
            side_channel = b""
            if state_wanted and any(asked.values()):  # it belongs to what a policy sees: a RESET before that changes it
                state = simulation.snapshot()
                side_channel = b"" if state is None else side_channels.write_state(state)
                state_wanted = False
            if self._refused:
                side_channel += side_channels.message(side_channels.AREA_STATE, b"")
                self._refused = False
            with blaming("What the simulation gave can't be sent"):
                side_channel = side_channels.write_statistics(statistics) + side_channel
                message = wire.output(parts, side_channel, introduced, form, can.hybridActions)
            introduced |= asked.keys()
            reply = self._connection.exchange(message)

    def _shake_hands(self, message: bytes) -> bytes:
        try:
            return self._connection.exchange(message)
        except ConnectionBroken as error:
            raise ConnectionBroken(
                f"{error} That was in the handshake, where Unity's player would go on by itself; this one ends."
            ) from error

    def _simulation(self, parameters: Any) -> Simulation:
        theirs = parameters.communication_version
        if theirs.split(".")[0] != API_VERSION.split(".")[0]:
            raise PlayerError(
                f"The trainer speaks communication version {theirs or 'unknown'} and this player {API_VERSION}; "
                "use an mlagents-envs whose version has the same major number."
            )
        if theirs != API_VERSION:
            logger.warning("The trainer speaks communication version %s, this player %s.", theirs, API_VERSION)
        seed = parameters.seed if self._seed is None else self._seed
        count = parameters.num_areas if parameters.num_areas > 1 else (self._num_areas or 1)
        if not 1 <= count <= MAX_AREAS:
            raise PlayerError(f"The trainer asks for {count} areas, but 1 to {MAX_AREAS} can be served.")
        logger.info("Trainer package %s, seed %d, %d areas.", parameters.package_version, seed, count)
        return CheckedSimulation(lambda: self._make_simulation(seed, count))

    def _apply_side_channels(self, simulation: Simulation, buffer: bytes) -> bool:
        """Does what the messages say; returns whether one asks for the simulation's state."""
        state_wanted = False
        for channel, payload in side_channels.split(buffer):
            if channel == side_channels.ENVIRONMENT_PARAMETERS:
                name, value = side_channels.read_environment_parameter(payload)
                try:
                    simulation.set_parameter(name, value)
                except ValueError as error:
                    logger.warning("%s It was ignored.", error)
                else:
                    logger.info("Environment parameter %s = %s.", name, value)
            elif channel == side_channels.ENGINE_CONFIGURATION:
                setting = side_channels.read_engine_setting(payload)
                logger.info("Engine setting %s noted: there is no engine to set.", setting)
            elif channel == side_channels.AREA_STATE and payload:
                self._restore(simulation, payload)
            elif channel == side_channels.AREA_STATE:
                state_wanted = True
            elif channel != side_channels.TRAINING_ANALYTICS:
                logger.warning("A message of %d bytes for unknown side channel %s was skipped.", len(payload), channel)
        return state_wanted

    def _restore(self, simulation: Simulation, payload: bytes) -> None:
        now = simulation.snapshot()
        if now is None:
            raise PlayerError("The trainer has a saved state to put back, but this player's simulation has none.")
        try:
            simulation.restore(side_channels.read_state(payload, now))
        except NotRestored as error:
            logger.warning("The saved state can't be put back (%s): new episodes begin.", error)
            self._refused = True
        else:
            logger.info("The areas go on where a saved run left them.")


def _wants_channels_first(package_version: str) -> bool:
    major = package_version.partition(".")[0]
    return major.isdigit() and int(major) >= 1
