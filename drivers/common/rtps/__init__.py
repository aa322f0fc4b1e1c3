"""Speak RTPS, the wire protocol of DDS, as far as robots need it.

It has discovery, best-effort and reliable delivery, and fragments.

    participant = Participant(address="192.168.123.99")      # sockets are open
    writer = participant.writer("rt/lowcmd", "unitree_hg::msg::dds_::LowCmd_")
    reader = participant.reader("rt/lowstate", "unitree_hg::msg::dds_::LowState_", on_sample)
    nursery.start_soon(participant.run)                       # or poll() now and then
    await participant.wait_matched(writer, reader)
    writer.write(payload)                                     # an ordinary function

A remote endpoint counts as matched once its participant has acknowledged that our endpoint exists.
A reliable one must also have sent a message to our endpoint. From then on, samples are received. The
age of a sample counts from the time at which the kernel received its datagram. Every table is
bounded (peers, remote endpoints, early samples, fragments), and drops are counted.

A datagram in a peer's name counts only if it comes from that peer's address, and its sequence
numbers must continue the last ones. So a single datagram from another address cannot end anything.
A sender that forges the address too is believed, because the protocol cannot prove it. Robots with
legs need a separate network.

Protocol 2.2, IPv4. No type information is sent, because peers of another generation fail on it. Not
supported: security, keys, content filters, deadlines, liveliness beyond the participant's lease,
IPv6.
"""

from .engine import Counters
from .participant import Participant, open_participant
from .reader import Reader
from .sockets import own_address
from .wire_types import CDR, MULTICAST_GROUP, PREFIX_SIZE
from .writer import Writer

__all__ = [
    "CDR",
    "MULTICAST_GROUP",
    "PREFIX_SIZE",
    "Counters",
    "Participant",
    "Reader",
    "Writer",
    "open_participant",
    "own_address",
]
