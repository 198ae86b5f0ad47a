"""A stand-in for Unity's runtime: what a Unity build does on the wire, without Unity. It needs grpcio alone."""
