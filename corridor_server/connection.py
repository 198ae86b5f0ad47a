"""The gRPC connection to a trainer. The trainer is the server; a player dials it."""

import os
import threading

import grpc

from corridor_server.protocol.messages import API_VERSION, EXCHANGE, MAX_MESSAGE_BYTES
from corridor_server.shared.addresses import authority, resolve
from corridor_server.shared.patience import LOOK_SECONDS, Patience

_OPTIONS = [
    ("grpc.max_receive_message_length", MAX_MESSAGE_BYTES),
    ("grpc.enable_http_proxy", 0),
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1000),
]


class ConnectionFailed(Exception):
    """No trainer can be talked to; the message is for the user."""


class ConnectionBroken(ConnectionFailed):
    """There was a trainer, and it is gone: an end of the session, as for Unity's player."""


class Connection:
    """A channel to the trainer at a host and port, open until ``close``.

    Args:
        host: Where the trainer listens.
        port: The trainer's port.
        timeout_wait: Seconds to wait for it; it is tried again and again, at most a second apart.
        timeout_reply: Seconds to wait for each reply: a trainer may learn for long between two of them.
        parent: The process that started this one and listens there; it is not waited for once it is gone.

    Raises:
        ConnectionFailed: Nobody listens there within ``timeout_wait``, or the parent is gone.
    """

    def __init__(
        self, host: str, port: int, timeout_wait: float, timeout_reply: float, parent: int | None = None
    ) -> None:
        self._timeout_reply = timeout_reply
        self._address = authority(host, port)
        self._channel = grpc.insecure_channel(self._address, options=_OPTIONS)
        ready = grpc.channel_ready_future(self._channel)
        patience = Patience(timeout_wait)
        while True:
            try:
                ready.result(timeout=patience.look())
                break
            except grpc.FutureTimeoutError as error:
                if parent is not None and os.getppid() != parent:
                    self._channel.close()
                    raise ConnectionFailed(f"The process {parent}, which started this player, is gone.") from error
                if patience.is_over():
                    self._channel.close()
                    try:
                        resolve(host)
                    except ValueError as unknown:
                        raise ConnectionFailed(f"{unknown} Give the trainer's host with --host.") from unknown
                    raise ConnectionFailed(
                        f"No trainer listens on {self._address} (waited {timeout_wait:g} s, ML-Agents API "
                        f"{API_VERSION}); start the trainer first, and give the player its port with --mlagents-port."
                    ) from error
        self._exchange = self._channel.unary_unary(EXCHANGE)
        self._patience: Patience | None = None  # while a reply is awaited
        self._hangs = False
        self._closed = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def exchange(self, message: bytes, timeout: float | None = None) -> bytes:
        """Sends a message's bytes and waits for the trainer's.

        Args:
            message: A serialised UnityMessageProto.
            timeout: Seconds; ``timeout_reply`` if not given.

        Raises:
            ConnectionBroken: The trainer is gone.
            ConnectionFailed: It is silent or has another player, or something else listens there.
        """
        self._patience = Patience(self._timeout_reply)
        try:
            reply: bytes = self._exchange(message, timeout=timeout)
        except grpc.RpcError as error:
            raise self._failure(error.code(), len(message)) from error
        finally:
            self._patience = None
        return reply

    def _watch(self) -> None:
        """Ends a wait for a reply that does not come: gRPC's own deadline would count this process's pauses, too."""
        patience = None
        while not self._closed.wait(LOOK_SECONDS if patience is None else patience.look()):
            if patience is not None and patience is self._patience and patience.is_over():
                self._hangs = True
                self.close()
            patience = self._patience

    def _failure(self, code: grpc.StatusCode, size: int) -> ConnectionFailed:
        match code:
            case _ if self._hangs:
                return ConnectionFailed(
                    f"The trainer at {self._address} sent no reply for {self._timeout_reply:g} s; it hangs."
                )
            case grpc.StatusCode.UNIMPLEMENTED:
                return ConnectionFailed(
                    f"What listens on {self._address} is no ML-Agents trainer (API {API_VERSION}); check the port."
                )
            case grpc.StatusCode.ALREADY_EXISTS:
                return ConnectionFailed(
                    f"The trainer at {self._address} has another player; give each player a port of its own."
                )
            case grpc.StatusCode.RESOURCE_EXHAUSTED:
                return ConnectionFailed(
                    f"The trainer at {self._address} takes no message of {size} bytes; use fewer areas or smaller "
                    "pictures, and leave out --camera-raw."
                )
            case _:
                return ConnectionBroken(
                    f"The connection to the trainer at {self._address} broke: it stopped or was killed ({code.name})."
                )

    def close(self) -> None:
        """Closes the channel."""
        self._closed.set()
        self._channel.close()
