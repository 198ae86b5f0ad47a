"""A conformance kit for ML-Agents players: does this one speak the protocol, and does it keep the corridor's contract?

Every topic is an abstract class whose ``test_`` methods are sentences. Subclass one, say in ``start_player`` how your
player is started, and pytest or unittest-like runners find the tests; ``corridor check`` runs all of them on a player
given by its path. The trainer they use, ``raw_trainer``, knows nothing but the messages.
"""

from trainer.conformance.actions import Actions
from trainer.conformance.bad_peers import BadPeers
from trainer.conformance.channels import SideChannels
from trainer.conformance.contract import CorridorContract
from trainer.conformance.episodes import Episodes
from trainer.conformance.handshake import Handshake
from trainer.conformance.reset import Reset
from trainer.conformance.shutdown import Shutdown
from trainer.conformance.suite import Conformance, NotApplicable
from trainer.conformance.visual import VisualObservations

PROTOCOL: tuple[type[Conformance], ...] = (
    Handshake,
    Episodes,
    Actions,
    Reset,
    SideChannels,
    VisualObservations,
    Shutdown,
    BadPeers,
)

__all__ = [
    "PROTOCOL",
    "Actions",
    "BadPeers",
    "Conformance",
    "CorridorContract",
    "Episodes",
    "Handshake",
    "NotApplicable",
    "Reset",
    "Shutdown",
    "SideChannels",
    "VisualObservations",
]
