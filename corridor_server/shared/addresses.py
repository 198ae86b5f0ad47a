"""Hosts and ports as users write them: names, IPv4, and IPv6 with or without brackets."""

import errno
import ipaddress
import re
import socket

from corridor_server.shared.given import Range, shown

LOOPBACK = "localhost"
PORTS = Range(1, 65535)
# Every address of this machine: each family's own, of which gRPC makes one for both.
WILDCARDS = {"0.0.0.0": socket.AF_INET, "::": socket.AF_INET6}


class PortInUse(Exception):
    """Somebody else listens there."""


def parse_host(text: str) -> str:
    """A host without the brackets that an IPv6 address may have.

    Raises:
        ValueError: The text is no name and no address.
    """
    try:
        host = re.sub(r"^\[(.*:.*)\]$", r"\1", text)
        if ":" in host:
            address = ipaddress.IPv6Address(host)
            return str(address.ipv4_mapped or address)
        if re.fullmatch(r"[\w-][\w.-]*", host):
            host.encode("idna")  # which refuses what is too long, or has an empty part
            return host
    except ValueError:  # both refusals are ValueErrors
        pass
    raise ValueError(
        f"{shown(text)} is no host; a name or an address was expected, such as {LOOPBACK}, 192.0.2.1 or ::1."
    )


def parse_address(text: str) -> tuple[str, int] | None:
    """Host and port of ``HOST:PORT``, ``[IPV6]:PORT`` or ``IPV6:PORT``; None if no number follows a last colon.

    Raises:
        ValueError: The host is none, or there is no such port.
    """
    host, colon, digits = text.rpartition(":")
    if not colon or not re.fullmatch(r"[0-9]+", digits):
        return None
    port = PORTS.parse(digits, whole=True)
    if port is None:
        raise ValueError(f"Port {digits[:20]} does not exist; ports go from 1 to 65535.")
    return parse_host(host), int(port)


def authority(host: str, port: int) -> str:
    """Host and port as gRPC and URLs have them."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def resolve(host: str, port: int = 0) -> list[tuple[socket.AddressFamily, str]]:
    """A host's addresses, to listen on, each once.

    Raises:
        ValueError: The name is not known.
    """
    if host in WILDCARDS:
        return [(family, address) for address, family in WILDCARDS.items()]
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ValueError(f"The host {host!r} is not known ({reason}).") from error
    return list(dict.fromkeys((family, str(address[0])) for family, _, _, _, address in found))


def is_loopback(host: str) -> bool:
    """Whether only this machine can connect to what listens on a host; a name that is not known counts as open."""
    try:
        addresses = [ipaddress.ip_address(address) for _, address in resolve(host)]
    except ValueError:
        return False
    return all(each.is_loopback for each in addresses)


def free_addresses(host: str, port: int) -> list[str]:
    """A host's addresses, on all of which nobody else may listen: a player may dial any of them.

    Raises:
        PortInUse: Somebody does, on one of them; the message is a sentence.
        ValueError: The host is not known or another machine's, or the port may not be opened.
    """
    free = []
    for family, address in resolve(host, port):
        try:
            with socket.socket(family, socket.SOCK_STREAM) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    probe.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                probe.bind((address, port))
        except OSError as error:
            if error.errno in (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT):
                continue  # a name's address of a family that this machine doesn't use
            if error.errno == errno.EADDRINUSE:
                raise PortInUse(f"Port {port} on {host} is in use; choose another.") from error
            raise ValueError(f"Port {port} on {host} can't be opened ({error.strerror}); choose another.") from error
        free.append(address)
    if not free:
        raise ValueError(
            f"The host {host!r} is no address of this machine, so nothing can listen there; take {LOOPBACK}, or "
            "0.0.0.0 to be reached from other machines."
        )
    return [host] if host in WILDCARDS else free
