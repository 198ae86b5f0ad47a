"""A gRPC server of the protocol's service and nothing around it: bytes in, bytes out."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import grpc

from corridor_server.protocol.messages import SERVICE

Answer = Callable[[bytes, grpc.ServicerContext], bytes]


def serve(answer: Answer, port: int = 0) -> tuple[grpc.Server, int]:
    """Starts a server on the port, or on any free one for 0; returns it and its port.

    Args:
        answer: Called with every request, in one of two threads.
        port: Where to listen, on loopback.
    """
    server = grpc.server(ThreadPoolExecutor(max_workers=2))
    handler = grpc.unary_unary_rpc_method_handler(answer)
    server.add_generic_rpc_handlers([grpc.method_handlers_generic_handler(SERVICE, {"Exchange": handler})])
    port = server.add_insecure_port(f"localhost:{port}")
    server.start()
    return server, port
