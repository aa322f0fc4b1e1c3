"""RTPS, the wire of DDS, as far as robots need it: discovery, best effort, reliable delivery,
fragments.

    participant = Participant(address="192.168.123.99")      # sockets are open
    writer = participant.writer("rt/lowcmd", "unitree_hg::msg::dds_::LowCmd_")
    reader = participant.reader("rt/lowstate", "unitree_hg::msg::dds_::LowState_", on_sample)
    nursery.start_soon(participant.run)                       # or poll() now and then
    await participant.wait_matched(writer, reader)
    writer.write(payload)                                     # an ordinary function

A peer counts as matched once it has acknowledged that our endpoint exists, a reliable one once it
has spoken to it: what is written from then on is heard. A sample is as old as its datagram's
arrival, by the kernel's time. Everything is bounded: peers, remote endpoints, samples that came too
early, fragments; what does not fit is counted.

What counts in a peer's name comes from that peer's address, and its numbers go on from the last:
one datagram from elsewhere ends nothing. Who forges the address, too, is believed: the protocol has
no proof of it. Legs belong on a network of their own.

Protocol 2.2, IPv4. No type information is sent: a peer of another generation stumbles over it. Not
here: security, keys, content filters, deadlines, liveliness beyond the participant's lease, IPv6.
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
