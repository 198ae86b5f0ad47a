"""The kit on our own player, strict sentences included: with both timings, and with a camera both ways."""

import numpy as np
import pytest
from conftest import BIN
from prepared import Prepared

from corridor_server.protocol.trainer_messages import initialization
from trainer import conformance
from trainer.conformance.session import agents
from trainer.conformance.verdicts import expect_equal


class CorridorServer:
    """How our player is started; what it prints goes to the test's own output."""

    strict = True

    def start_player(self, port: int, *arguments: str) -> Prepared:
        return Prepared([BIN / "corridor-server", "--mlagents-port", port, *arguments])


class InUnitysTiming(CorridorServer):
    """Ended agents in a message of their own, and an idle step after every RESET."""

    arguments = ("--decision-timing", "unity")
    pytestmark = pytest.mark.slow


class TestHandshake(CorridorServer, conformance.Handshake): ...


class TestEpisodes(CorridorServer, conformance.Episodes): ...


class TestEpisodesInUnitysTiming(InUnitysTiming, conformance.Episodes): ...


class TestObservations(CorridorServer, conformance.Observations): ...


class TestActions(CorridorServer, conformance.Actions): ...


class TestReset(CorridorServer, conformance.Reset): ...


class TestResetInUnitysTiming(InUnitysTiming, conformance.Reset): ...


class TestSideChannels(CorridorServer, conformance.SideChannels): ...


class TestShutdown(CorridorServer, conformance.Shutdown): ...


class TestBadPeers(CorridorServer, conformance.BadPeers): ...


class TestCorridorContract(CorridorServer, conformance.CorridorContract): ...


class TestCorridorContractInUnitysTiming(InUnitysTiming, conformance.CorridorContract): ...


class TestVisualObservationsAsPng(CorridorServer, conformance.VisualObservations):
    arguments = ("--camera", "40x24")


class TestVisualObservationsAsFloats(CorridorServer, conformance.VisualObservations):
    arguments = ("--camera", "40x24", "--camera-raw")


@pytest.mark.parametrize(("package", "shape"), [("0.28.0", [24, 40, 3]), ("1.1.0", [3, 24, 40])])
def test_a_pictures_layout_is_what_the_trainers_release_expects(package, shape):
    """The protocol's version does not tell them apart."""

    class Camera(CorridorServer, conformance.Conformance):
        arguments = ("--camera", "40x24", "--camera-raw")

    with Camera().connected() as session:
        session.trainer.receive()
        session.trainer.ask(initialization(package=package))
        picture = agents(session.reset())[0].observations[0]
        expect_equal(list(picture.shape), shape, "shape")
        values = np.array(picture.float_data.data).reshape(shape)
        corner = values[0, 0] if shape[-1] == 3 else values[:, 0, 0]
        np.testing.assert_allclose(corner, 1.0, err_msg="white, outside the walls")
