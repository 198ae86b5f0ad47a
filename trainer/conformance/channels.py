"""Bytes beside the agents: what comes in and what goes out."""

import struct
import uuid

from corridor_server.protocol import side_channels as channels
from trainer.conformance.session import agents
from trainer.conformance.suite import Conformance, needs
from trainer.conformance.verdicts import NotAsExpected, expect, expect_equal


def environment_parameter(name: str, value: float) -> bytes:
    """One message that sets a parameter to a float."""
    key = name.encode()
    payload = struct.pack("<i", len(key)) + key + struct.pack("<if", channels.FLOAT, value)
    return channels.message(channels.ENVIRONMENT_PARAMETERS, payload)


class SideChannels(Conformance):
    """Bytes beside the agents: what comes in and what goes out."""

    def _is_accepted(self, buffer: bytes) -> None:
        with self.playing() as session:
            session.step(0.1, side_channel=buffer)
            expect(agents(session.output), "no agents", "at least one")

    def test_engine_settings_are_accepted(self) -> None:
        settings = [struct.pack("<3i", 0, 80, 60), struct.pack("<2i", 1, 1), struct.pack("<if", 2, 20.0)]
        settings += [struct.pack("<2i", 3, -1), struct.pack("<2i", 4, 60)]
        self._is_accepted(b"".join(channels.message(channels.ENGINE_CONFIGURATION, each) for each in settings))

    def test_an_environment_parameter_is_accepted(self) -> None:
        self._is_accepted(environment_parameter("a_parameter_that_no_player_has", 1.0))

    def test_samplers_are_accepted(self) -> None:
        name = struct.pack("<i", 1) + b"x" + struct.pack("<i", channels.SAMPLER)
        samplers = [struct.pack("<2i2f", 1, channels.UNIFORM, 0.0, 1.0)]
        samplers.append(struct.pack("<2i2f", 1, channels.GAUSSIAN, 0.0, 1.0))
        samplers.append(struct.pack("<3i2f", 1, channels.MULTI_RANGE_UNIFORM, 2, 0.0, 1.0))
        self._is_accepted(b"".join(channels.message(channels.ENVIRONMENT_PARAMETERS, name + each) for each in samplers))

    def test_training_analytics_are_accepted(self) -> None:
        self._is_accepted(channels.message(channels.TRAINING_ANALYTICS, b"anything"))

    def test_an_unknown_channel_is_skipped(self) -> None:
        unknown = channels.message(uuid.UUID("12345678-1234-5678-1234-567812345678"), b"\x00\x01\x02")
        self._is_accepted(unknown + environment_parameter("a_parameter_that_no_player_has", 1.0))

    @needs("side-channel bytes")
    def test_the_players_own_messages_are_whole(self) -> None:
        with self.playing(num_areas=4) as session:
            for output in session.play(1000):
                if not output.rl_output.side_channel:
                    continue
                try:
                    messages = list(channels.split(output.rl_output.side_channel))
                except channels.SideChannelError as error:
                    raise NotAsExpected(str(error)) from error
                for channel, payload in messages:
                    if channel == channels.STATISTICS:
                        key_length = int.from_bytes(payload[:4], "little", signed=True)
                        expect_equal(len(payload), 4 + key_length + 8, "a statistic's size in bytes is")
                expect(messages, "bytes without a message", "at least one")
