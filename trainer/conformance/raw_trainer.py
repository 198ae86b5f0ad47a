"""A trainer of our own, to hold players against: a gRPC server whose every reply the test decides, byte by byte."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any

import grpc

from corridor_server.protocol.messages import API_VERSION, RESET, SERVICE, UnityMessageProto
from corridor_server.protocol.trainer_messages import command, initialization, step
from corridor_server.shared.addresses import authority, free_addresses
from corridor_server.shared.patience import Patience


class NothingReceived(AssertionError):
    """The player sent no message in time."""


class RawTrainer:
    """Listens on a free loopback port; the player's messages come one at a time, and wait for their replies.

    Args:
        timeout: Seconds to wait for each message.
        port: 0 takes a free one.
        host: Where to listen.
    """

    def __init__(self, timeout: float = 20.0, port: int = 0, host: str = "localhost") -> None:
        self._timeout = timeout
        self._received: SimpleQueue[bytes] = SimpleQueue()
        self._replies: SimpleQueue[bytes] = SimpleQueue()
        self._server = grpc.server(ThreadPoolExecutor(max_workers=4), options=[("grpc.so_reuseport", 0)])
        exchange = grpc.unary_unary_rpc_method_handler(self._answer)  # bytes in, bytes out
        self._server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(SERVICE, {"Exchange": exchange})])
        for address in free_addresses(host, port) if port else [host]:
            self.port: int = self._server.add_insecure_port(authority(address, port))
        self._server.start()

    def __enter__(self) -> "RawTrainer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.cut()

    def _answer(self, request: bytes, context: grpc.ServicerContext) -> bytes:
        self._received.put(request)
        return self._replies.get()

    def cut(self) -> None:
        """Breaks the connection without a word."""
        self._server.stop(grace=None)
        for _ in range(4):
            self._replies.put(b"")  # lets handlers end that wait for a reply nobody will read

    def receive_bytes(self, timeout: float | None = None) -> bytes:
        """The player's next message as it came.

        Args:
            timeout: Seconds to wait, if not as long as for every message.

        Raises:
            NothingReceived: None came in time.
        """
        seconds = self._timeout if timeout is None else timeout
        patience = Patience(seconds)
        while True:
            try:
                return self._received.get(timeout=patience.look())
            except Empty:
                if patience.is_over():
                    raise NothingReceived(f"the player sent nothing for {seconds:g} s") from None

    def receive(self) -> Any:
        """The player's next message (UnityMessageProto)."""
        return UnityMessageProto.FromString(self.receive_bytes())

    def reply_bytes(self, data: bytes) -> None:
        """Answers the last message with any bytes."""
        self._replies.put(data)

    def reply(self, message: Any) -> None:
        """Answers the last message."""
        self.reply_bytes(message.SerializeToString())

    def ask(self, message: Any) -> Any:
        """Answers the last message and waits for the next."""
        self.reply(message)
        return self.receive()

    def handshake(self, seed: int = 0, num_areas: int = 1, version: str = API_VERSION) -> Any:
        """Receives the player's first message, answers it, receives the acknowledgement; returns the first."""
        hello = self.receive()
        self.reply(initialization(seed, num_areas, version))
        self.receive()
        return hello

    def reset(self, side_channel: bytes = b"") -> Any:
        """Sends RESET; returns the player's output."""
        return self.ask(command(RESET, side_channel)).unity_output

    def step(self, actions: Mapping[str, Sequence[Sequence[float]]], side_channel: bytes = b"") -> Any:
        """Sends STEP with continuous actions by behavior; returns the player's output."""
        return self.ask(step(actions, side_channel)).unity_output
