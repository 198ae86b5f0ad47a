"""Trainers that misbehave: whatever they send, a player ends or goes on, and never hangs."""

from corridor_server.protocol.trainer_messages import command, initialization, step
from corridor_server.shared.patience import Patience
from trainer.conformance.raw_trainer import NothingReceived
from trainer.conformance.session import Session
from trainer.conformance.suite import Conformance, strict
from trainer.conformance.verdicts import NotApplicable, expect

PATIENCE_SECONDS = 10.0


class BadPeers(Conformance):
    """Trainers that misbehave: whatever they send, a player ends or goes on, and never hangs."""

    def _ends_or_goes_on(self, session: Session) -> None:
        """After a bad reply: either the player answers, or its process ends."""
        patience, reacted = Patience(PATIENCE_SECONDS), False
        while not reacted and not patience.is_over():
            reacted = session.process is not None and session.process.poll() is not None
            try:
                session.trainer.receive_bytes(timeout=0.05)
                reacted = True
            except NothingReceived:
                continue
        if not reacted and session.process is None:
            raise NotApplicable("the player sends nothing more, and its process can't be seen")
        expect(reacted, f"silence for {PATIENCE_SECONDS:g} s", "an answer or an end")

    def test_bytes_that_are_no_message(self) -> None:
        with self.playing() as session:
            session.trainer.reply_bytes(b"\xff" * 40)
            self._ends_or_goes_on(session)

    def test_a_message_that_is_empty(self) -> None:
        with self.playing() as session:
            session.trainer.reply_bytes(b"")
            self._ends_or_goes_on(session)

    def test_a_second_initialization_in_mid_session(self) -> None:
        with self.playing() as session:
            session.trainer.reply(initialization())
            self._ends_or_goes_on(session)

    def test_too_few_and_too_many_actions(self) -> None:
        for surplus in (-1, 1):
            with self.playing(num_areas=2) as session:
                session.to_decisions()
                session.trainer.reply(session.wrong_count(surplus))
                self._ends_or_goes_on(session)

    def test_actions_of_the_wrong_size(self) -> None:
        for surplus in (-1, 1):
            with self.playing() as session:
                session.to_decisions()
                session.trainer.reply(session.wrong_size(surplus))
                self._ends_or_goes_on(session)

    def test_actions_for_a_behavior_that_does_not_exist(self) -> None:
        with self.playing() as session:
            session.trainer.reply(step({"Nobody?team=9": [[0.0]]}))
            self._ends_or_goes_on(session)

    def test_a_command_that_does_not_exist(self) -> None:
        with self.playing() as session:
            session.trainer.reply(command(77))
            self._ends_or_goes_on(session)

    def test_side_channel_bytes_that_are_cut_or_garbage(self) -> None:
        for buffer in (b"\x01", b"\x00" * 19, b"\x07" * 24, b"\x00" * 16 + b"\xff\xff\xff\x7f", bytes(range(256))):
            with self.playing() as session:
                session.trainer.reply(session.message(0.0, buffer))
                self._ends_or_goes_on(session)

    @strict
    def test_bytes_that_are_no_message_in_the_handshake(self) -> None:
        with self.connected() as session:
            session.trainer.receive()
            session.trainer.reply_bytes(b"\x0a\xff\xff\xff\xff\x0f")
            self._ends_or_goes_on(session)
