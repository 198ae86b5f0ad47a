"""A bare gRPC client in a process of its own: ``python echo_program.py PORT BYTES METHOD``.

For every line that it reads, a number of seconds, it sends so many bytes again and again for so long, and prints its
round trips per second.
"""

import sys
import time

import grpc

CONNECT_SECONDS = 20


def main(port: int, size: int, method: str) -> None:
    """Connects, and measures whenever a line comes, until there are no more."""
    channel = grpc.insecure_channel(f"localhost:{port}")
    grpc.channel_ready_future(channel).result(CONNECT_SECONDS)
    call, data = channel.unary_unary(method), b"x" * size
    print("ready", flush=True)
    for line in sys.stdin:
        begun, count = time.perf_counter(), 0
        while time.perf_counter() - begun < float(line):
            call(data)
            count += 1
        print(count / (time.perf_counter() - begun), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
