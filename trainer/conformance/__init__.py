"""A conformance kit for ML-Agents players: does this one speak the protocol, and does it keep the corridor's contract?

Every topic is an abstract class whose ``test_`` methods are sentences, on two levels: the protocol as Unity's own
runtime keeps it, and, marked ``strict``, what corridor-server promises beyond. Subclass one, say in ``start_player``
how your player is started, and pytest or unittest-like runners find the tests; ``corridor check`` runs all of them on a
player given by its path. The trainer they use, ``raw_trainer``, knows nothing but the messages.
"""

from trainer.conformance.actions import Actions
from trainer.conformance.bad_peers import BadPeers
from trainer.conformance.channels import SideChannels
from trainer.conformance.contract import CorridorContract
from trainer.conformance.episodes import Episodes
from trainer.conformance.handshake import Handshake
from trainer.conformance.observations import Observations
from trainer.conformance.reset import Reset
from trainer.conformance.shutdown import Shutdown
from trainer.conformance.suite import Conformance
from trainer.conformance.verdicts import NotApplicable
from trainer.conformance.visual import VisualObservations

TOPICS: tuple[type[Conformance], ...] = (
    Handshake,
    Episodes,
    Observations,
    Actions,
    Reset,
    SideChannels,
    VisualObservations,
    Shutdown,
    BadPeers,
)

__all__ = [
    "TOPICS",
    "Actions",
    "BadPeers",
    "Conformance",
    "CorridorContract",
    "Episodes",
    "Handshake",
    "NotApplicable",
    "Observations",
    "Reset",
    "Shutdown",
    "SideChannels",
    "VisualObservations",
]
