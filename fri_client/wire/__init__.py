"""The wire: bytes of FRI datagrams to messages and back, for every version of the protocol."""
