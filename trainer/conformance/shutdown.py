"""How a player ends."""

import signal

from corridor_server.protocol.messages import OK
from corridor_server.protocol.trainer_messages import quitting, stopping
from trainer.conformance.suite import Conformance, strict
from trainer.conformance.verdicts import NotApplicable, expect, expect_equal


class Shutdown(Conformance):
    """How a player ends."""

    def test_quit_ends_the_player_with_code_0(self) -> None:
        with self.playing() as session:
            session.step(0.1)
            session.trainer.reply(quitting())
            expect_equal(session.exit_code(), 0, "exit code")

    def test_any_status_other_than_200_ends_the_player_with_code_0(self) -> None:
        for status in (400, 0, 500):
            with self.playing() as session:
                session.step(0.1)
                session.trainer.reply(stopping(status))
                expect_equal(session.exit_code(), 0, f"status {status}: exit code")

    def test_a_broken_connection_ends_the_player_with_code_0(self) -> None:
        with self.playing() as session:
            session.step(0.1)
            session.trainer.cut()
            expect_equal(session.exit_code(), 0, "exit code")

    @strict
    def test_a_connection_broken_in_the_handshake_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.cut()
            expect_equal(session.exit_code(), 0, "exit code")

    @strict
    def test_quit_as_the_first_command_ends_the_player_with_code_0(self) -> None:
        with self.connected() as session:
            session.trainer.handshake()
            session.trainer.reply(quitting())
            expect_equal(session.exit_code(), 0, "exit code")

    @strict
    def test_a_player_that_is_told_to_stop_says_so_with_another_status(self) -> None:
        with self.playing() as session:
            if session.process is None:
                raise NotApplicable("the player was not started here, so it can't be asked to stop")
            session.process.send_signal(signal.SIGTERM)
            farewell = session.trainer.receive()
            expect(farewell.header.status != OK, "a message with status 200", "another one")
            session.trainer.reply(stopping())
            expect_equal(session.exit_code(), 0, "exit code")
