"""The trainer's end of the gRPC connection: what ``UnityEnvironment`` exchanges messages through.

Same contract as ``mlagents_envs.rpc_communicator.RpcCommunicator``, with three differences: it listens on one host,
loopback by default, instead of everywhere; messages pass between threads without pickling; and a player whose
connection breaks is noticed at once.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

import grpc
import psutil
from google.protobuf.message import DecodeError
from mlagents_envs.communicator import Communicator
from mlagents_envs.exception import (
    UnityCommunicationException,
    UnityTimeOutException,
    UnityWorkerInUseException,
)

from corridor_server.protocol.messages import MAX_MESSAGE_BYTES, OK, SERVICE, UnityMessageProto, mistyped_field
from corridor_server.protocol.trainer_messages import stopping, trainer_message
from corridor_server.protocol.wire_bytes import HEADER_OK
from corridor_server.shared.addresses import LOOPBACK, PortInUse, authority, free_addresses
from corridor_server.shared.patience import Patience
from trainer.players.announcements import check_hello
from trainer.signals import deferred

HANDLERS = 2  # a player that says farewell has a call of its own beside the one that it gave up
EXIT_LOOKS = 100

PollCallback = Callable[[], None]


class ExchangeCommunicator(Communicator):  # type: ignore[misc]  # mlagents_envs has no type information
    """Serves one player on ``host:(base_port + worker_id)``.

    Args:
        worker_id: Number of the player, added to the port.
        base_port: First port.
        timeout_wait: Seconds to wait for each message of the player.
        host: Where to listen. The protocol has no authentication: anything but loopback trusts the network.

    Attributes:
        end_announced: Whether the player has said that it stops by itself (any status but 200).

    Raises:
        UnityWorkerInUseException: The port is taken.
    """

    def __init__(self, worker_id: int, base_port: int, timeout_wait: float, host: str = LOOPBACK) -> None:
        super().__init__(worker_id, base_port)
        self.end_announced = False
        self._timeout_wait = timeout_wait
        # From the player: a message's bytes, or None when its connection broke. To the player: its next message.
        self._received: SimpleQueue[bytes | None] = SimpleQueue()
        self._replies: SimpleQueue[bytes] = SimpleQueue()
        self._unanswered = False  # whether the player owes an answer, which an interrupt or a timeout left unread
        self._peer: str | None = None
        self._pool = _DaemonPool(HANDLERS)
        try:
            self._server: grpc.Server | None = self._serve(worker_id, host, base_port + worker_id)
        except BaseException:
            self._pool.shutdown()
            raise

    def _serve(self, worker_id: int, host: str, port: int) -> grpc.Server:
        try:
            addresses = free_addresses(host, port)
        except PortInUse as error:
            raise UnityWorkerInUseException(worker_id) from error
        except ValueError as error:
            raise UnityCommunicationException(str(error)) from error
        server = grpc.server(
            self._pool,
            options=[("grpc.so_reuseport", 0), ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES)],
        )
        exchange = grpc.unary_unary_rpc_method_handler(self._answer)  # bytes in, bytes out
        server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(SERVICE, {"Exchange": exchange})])
        with deferred():  # a server that is dropped while it starts waits for its own end forever
            try:
                for address in addresses:
                    server.add_insecure_port(authority(address, port))
            except RuntimeError as error:
                raise UnityWorkerInUseException(worker_id) from error
            server.start()
        return server

    def _answer(self, request: bytes, context: grpc.ServicerContext) -> bytes:
        """Hands the player's message to the trainer's thread and waits for the reply (runs in a gRPC thread)."""
        if self._peer is None:
            self._peer = context.peer()
        elif context.peer() != self._peer:
            context.abort(grpc.StatusCode.ALREADY_EXISTS, "Another player is connected to this trainer.")
        answered = False

        def ended() -> None:
            if not answered:
                self._received.put(None)

        if not context.add_callback(ended):
            self._received.put(None)
        if not request.startswith(HEADER_OK):
            with suppress(UnityCommunicationException):  # which the trainer's thread will raise
                self.end_announced = parse(request).header.status != OK
        self._received.put(request)
        reply = self._replies.get()
        answered = True
        return reply

    def initialize(self, inputs: Any, poll_callback: PollCallback | None = None) -> Any:
        """Waits for the player's first message, answers it, and returns what it said."""
        first = self._receive(poll_callback)
        if first is None or self.exchange_bytes(serialise(inputs), poll_callback) is None:
            raise UnityCommunicationException("The player broke the connection during the handshake.")
        output = parse(first).unity_output
        check_hello(output)
        return output

    def exchange(self, inputs: Any, poll_callback: PollCallback | None = None) -> Any:
        """Sends a command and returns the player's answer, or None when the player has stopped."""
        data = self.exchange_bytes(serialise(inputs), poll_callback)
        return None if data is None else parse(data).unity_output

    def exchange_bytes(self, message: bytes, poll_callback: PollCallback | None = None) -> bytes | None:
        """Sends a serialised UnityMessageProto and returns the player's, or None when the player has stopped.

        The answer to an earlier one that nobody waited for to its end is taken and dropped before.
        """
        if self._unanswered and self._receive(poll_callback) is None:
            return None
        self.send(message)
        return self.receive(poll_callback)

    def send(self, message: bytes) -> None:
        """Sends a serialised UnityMessageProto, and does not wait for the answer."""
        self._unanswered = True
        self._replies.put(message)

    def receive(self, poll_callback: PollCallback | None = None) -> bytes | None:
        """The player's answer to what was sent, serialised, or None when the player has stopped."""
        data = self._receive(poll_callback)
        if data is None or data.startswith(HEADER_OK) or parse(data).header.status == OK:
            return data
        return None

    def close(self) -> None:
        """Tells the player to stop and closes the port."""
        if self._server is None:
            return
        stop = stopping().SerializeToString()
        for _ in range(HANDLERS):
            self._replies.put(stop)
        self._server.stop(grace=1.0).wait()
        self._pool.shutdown()
        self._server = None

    def _receive(self, poll_callback: PollCallback | None) -> bytes | None:
        """The player's next message, or None when its connection broke.

        Raises:
            UnityTimeOutException: Nothing came within ``timeout_wait``.
            UnityEnvironmentException: ``poll_callback`` found the player's process dead.
        """
        patience = Patience(self._timeout_wait)
        while True:
            try:
                data = self._received.get(timeout=patience.look())
                break
            except Empty:
                if poll_callback is not None:
                    poll_callback()
                if not self._connected():
                    data = None
                    break
                if patience.is_over():
                    raise UnityTimeOutException(f"The player sent nothing for {self._timeout_wait:g} s.") from None
        self._unanswered = False
        if data is None:
            _wait_for_exit(poll_callback)
        return data

    def _connected(self) -> bool:
        """Whether the player's connection still stands; between two calls, gRPC itself does not tell."""
        if self._peer is None or not self._peer.startswith(("ipv4:", "ipv6:")):
            return True
        port = int(self._peer.rpartition(":")[2])
        return any(each.raddr and each.raddr.port == port for each in psutil.Process().net_connections("tcp"))


class _DaemonPool(Executor):
    """Runs calls in daemon threads: Python waits at exit for a ThreadPoolExecutor's, and ours may wait for a reply."""

    def __init__(self, workers: int) -> None:
        self._calls: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._workers = workers
        for _ in range(workers):
            threading.Thread(target=self._work, daemon=True).start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **options: Any) -> "Future[Any]":
        future: Future[Any] = Future()

        def call() -> None:
            try:
                future.set_result(function(*args, **options))
            except Exception as error:
                future.set_exception(error)

        self._calls.put(call)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        for _ in range(self._workers):
            self._calls.put(None)

    def _work(self) -> None:
        while (call := self._calls.get()) is not None:
            call()


def serialise(inputs: Any) -> bytes:
    """The message (a serialised UnityMessageProto) around a UnityInputProto."""
    data: bytes = trainer_message(inputs).SerializeToString()
    return data


def parse(data: bytes) -> Any:
    """A player's message (UnityMessageProto).

    Raises:
        UnityCommunicationException: The bytes are none, have no header, or a field that is of another type.
    """
    try:
        message = UnityMessageProto.FromString(data)
    except DecodeError as error:
        raise UnityCommunicationException(
            f"The player sent {len(data)} bytes that are not a message of the ML-Agents protocol."
        ) from error
    mistyped = mistyped_field(message)
    if mistyped is not None:
        raise UnityCommunicationException(f"The player sent {mistyped} as another type than the protocol's.")
    if not message.header.status:
        raise UnityCommunicationException(
            f"The player sent {len(data)} bytes without a header's status; {OK} was expected."
        )
    return message


def _wait_for_exit(poll_callback: PollCallback | None) -> None:
    """A process that broke its connection is about to end: lets the callback report its exit code, if it does."""
    if poll_callback is not None:
        for _ in range(EXIT_LOOKS):
            poll_callback()
            time.sleep(0.02)
